"""Flow of a stiff run from one sample to the next: Radau IIA of order 5, from SciPy, one step at a time.

The relative tolerance is 1e-9, the absolute one 1e-10 of the size a state has reached: the error of a step falls with
its fourth power only, so what the explicit method keeps (1e-11) would take three times the steps. Dense output is the
collocation polynomial, of order 3. Source: HairerWanner1996, IV.8.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.expression import ZERO
from cdobs_cli.simulate import dormand_prince
from cdobs_cli.simulate.integrator import End, Progress, Watch, first_step
from cdobs_cli.simulate.loop import ClosedLoop
from cdobs_cli.simulate.trigger import Along

if TYPE_CHECKING:
    from scipy.integrate import Radau

    from cdobs_cli.simulate.record import Grid

RTOL = 1e-9
LOOSER = 100  # ATOL: so many times the explicit method's
EVALUATIONS = 12  # of the flow, in what counts as one step: those of an explicit one
# Steps take ten times as long as explicit ones, and runs go one after the other.
MAX_STEPS_TOGETHER = 200_000


class ImplicitRun:
    """The flow of single runs, of one or many, each until its end."""

    def __init__(self, loop: ClosedLoop, horizon: float, max_steps: int) -> None:
        self.loop, self.horizon, self.max_steps = loop, horizon, max_steps
        self.jacobian = Jacobian(loop)
        self._flow = loop.scalar_flow()

    def advance(self, run: int, progress: Progress, end: float, grid: Grid, watch: Watch) -> int:
        """Flow run number `run` to its end; returns the End code."""
        runs = np.array([run])
        t, y, held = (part.copy() for part in progress.at(runs))
        floor = progress.floor(runs)[:, 0]
        # The state just after a jump has not been looked at yet.
        code = End.HALTED if watch(runs, t, y, held)[run] else End.REACHED
        if code == End.HALTED or not t[0] < end:
            return code
        solver = self._solver(float(t[0]), y[:, 0], held[:, 0], floor, end)
        if solver is None:
            return End.SINGULAR
        while code == End.REACHED and solver.status == "running":
            if progress.steps[run] >= self.max_steps:
                return End.EXHAUSTED
            evaluated = solver.nfev
            if not _stepped(solver):
                return End.SINGULAR
            progress.steps[run] += max(1, (solver.nfev - evaluated) // EVALUATIONS)
            step, until, new = _along(self.loop, solver, held), np.array([solver.t]), solver.y[:, None]
            if self.loop.is_triggered and (theta := step.first_root())[0] <= 1.0:
                part, new = step.polished(partial(self._part, step, floor), theta)
                until, code = step.t + part, End.TRIGGERED
            _fill(grid, run, float(until[0]), step)
            progress.t[run], progress.y[:, run], progress.h[run] = until[0], new[:, 0], solver.h_abs
            code = End.HALTED if watch(runs, until, new, held)[run] else code
        return code

    def _solver(
        self, t: float, y: Array, held: Array, floor: Array, end: float, h: float | None = None
    ) -> Radau | None:
        """Radau's method at the start of a flow; None where the flow is undefined there."""
        from scipy.integrate import Radau

        slope, values = self._slope(held), tuple(held.tolist())
        k = slope(t, y)
        if not np.isfinite(k).all():
            return None
        h = min(end - t, first_step(y, k, floor, self.horizon) if h is None else h)
        options: dict[str, Any] = {"rtol": RTOL, "atol": LOOSER * floor, "first_step": h}
        return Radau(slope, t, y, end, jac=partial(self.jacobian, held=values), **options)

    def _slope(self, held: Array) -> Callable[[float, Array], Array]:
        """f(t, y) (n,), nan where it is undefined."""
        values, flow, undefined = tuple(held.tolist()), self._flow, np.full(self.loop.size, np.nan)

        def slope(t: float, y: Array) -> Array:
            try:
                return np.array(flow(float(t), *y.tolist(), *values), dtype=float)
            except (ArithmeticError, ValueError, TypeError):
                return undefined

        return slope

    def _part(self, step: Along, floor: Array, s: Array) -> tuple[Array, Array]:
        """The state a time s (1,) after the start of a step, from steps of its own, by dense output if they fail; and
        its slope."""
        start, y = float(step.t[0]), step.y[:, 0]
        end = start + float(s[0])
        # A root within rounding of the start leaves no length for a step.
        solver = self._solver(start, y, step.held[:, 0], floor, end, float(s[0])) if end > start else None
        while solver is not None and solver.status == "running" and _stepped(solver):
            pass
        if solver is None or solver.status != "finished":
            state = dormand_prince.interpolate(step.coefficients, step.y, s / step.h)
        else:
            state = solver.y[:, None]
        return state, self._slope(step.held[:, 0])(end, state[:, 0])[:, None]


class Jacobian:
    """The derivatives of the flow by the states, from its expressions."""

    def __init__(self, loop: ClosedLoop) -> None:
        rows = [[row.derivative(name) for name in loop.states] for row in loop.flow]
        self._places = [(i, j) for i, row in enumerate(rows) for j, entry in enumerate(row) if entry != ZERO]
        self._values = compile_floats([rows[i][j] for i, j in self._places], loop.names, arrays=False)
        self._flat = np.array([i * loop.size + j for i, j in self._places], dtype=np.int64)
        self._zero = np.zeros((loop.size, loop.size))

    def __call__(self, t: float, y: Array, held: tuple[float, ...]) -> Array:
        """(n, n). It steers iterations only, so an entry that is undefined may be left 0."""
        J = self._zero.copy()
        try:
            J.flat[self._flat] = self._values(float(t), *y.tolist(), *held)
        except (ArithmeticError, ValueError, TypeError):
            return J
        return np.nan_to_num(J, nan=0.0, posinf=0.0, neginf=0.0)

    def fastest(self, t: float, y: Array, held: tuple[float, ...]) -> float:
        """The largest |eigenvalue| (per time unit)."""
        return float(np.abs(np.linalg.eigvals(self(t, y, held))).max())


def _stepped(solver: Radau) -> bool:
    """One step; False where none, however small, is accurate."""
    with warnings.catch_warnings():
        # A matrix that is singular at one step size is regular at the next.
        warnings.simplefilter("ignore")
        try:
            solver.step()
        except (ArithmeticError, ValueError, np.linalg.LinAlgError):
            return False
    return solver.status != "failed" and bool(np.isfinite(solver.y).all())


def _fill(grid: Grid, run: int, until: float, step: Along) -> None:
    """Read all times up to `until` from a step of one run."""
    points, places = grid.take(run, until)
    if len(points):
        theta = (points - step.t) / step.h
        y = dormand_prince.interpolate_one(step.coefficients[:, :, 0], step.y[:, 0], theta)
        grid.put(run, places, y, step.held)


def _along(loop: ClosedLoop, solver: Radau, held: Array) -> Along:
    """The last step, with the collocation polynomial y + sum_k q_k theta^k in the basis of `interpolate`."""
    dense: Any = solver.dense_output()
    q_1, q_2, q_3 = dense.Q.T
    coefficients = np.zeros((7, len(q_1), 1))
    coefficients[:3, :, 0] = q_1 + q_2 + q_3, -q_2 - q_3, -q_3
    y, t, h = dense.y_old[:, None], np.array([dense.t_old]), np.array([dense.h])
    return Along(loop.trigger, coefficients, y, t, h, held)
