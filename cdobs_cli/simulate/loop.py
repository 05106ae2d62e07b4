"""The closed loop compiled: every expression of a hybrid system as a function of numbers.

Every function takes (t, y, held): the time, all states (the plant's, then the observer's), and what is held
between samples: the controlled inputs, the last measurement `last.y.0`, .. where an input is a function of it, the
disturbance `d.0`, .. where it is drawn, the noise `held.v.0`, .. where sensors compare, and `t.k`, the time of the last
sample.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from cdobs_cli.arrays import Array, Integers
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.expression import Expression, Number, Variable
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.records import dataclass
from cdobs_cli.run import ESTIMATE
from cdobs_cli.simulate.signals import Signals

LAST_SAMPLE = "t.k"
LAST_MEASURED = "last.y."
HELD_NOISE = "held.v."


@dataclass(frozen=True)
class View:
    """What can be seen of the loop at points (P,): x (n, P); estimates by name (n, P); internals, inputs
    and other signals by name (P,); stops (s, P)."""

    x: Array
    estimates: Mapping[str, Array]
    internals: Mapping[str, Array]
    signals: Mapping[str, Array]
    stops: Array

    @property
    def error(self) -> Array | None:
        """Of x_hat, or of the middle of [x_lower, x_upper], shape (n, P); None where neither is reported."""
        if "x_hat" in self.estimates:
            return self.estimates["x_hat"] - self.x
        if self.encloses:
            return (self.estimates["x_lower"] + self.estimates["x_upper"]) / 2 - self.x
        return None

    @property
    def encloses(self) -> bool:
        return "x_lower" in self.estimates and "x_upper" in self.estimates

    @property
    def margin(self) -> Array:
        """min over the states of min(x - x_lower, x_upper - x), shape (P,); nan comes out as -inf."""
        inside = np.minimum(self.x - self.estimates["x_lower"], self.estimates["x_upper"] - self.x).min(axis=0)
        return np.where(np.isnan(inside), -np.inf, inside)


@dataclass(frozen=True)
class Routine:
    """One function of the loop: `rows` over `names`, then over what only this one reads."""

    rows: tuple[Expression, ...]
    names: tuple[str, ...]
    further: tuple[str, ...] = ()

    def arrays(self) -> Callable[..., tuple[Any, ...]]:
        """Over numpy arrays, one a name."""
        return compile_floats(self.rows, (*self.names, *self.further), arrays=True)


class ClosedLoop:
    """A hybrid system with its signals put in."""

    def __init__(self, system: HybridSystem, signals: Signals) -> None:
        self.system, self.signals = system, signals
        self.plant, self.observer = system.plant, system.observer
        self.controls = tuple(self.observer.control)
        # A measurement is held where an input reads it.
        kept = range(self.plant.p if signals.reads_measurements else 0)
        self.last_measured = tuple(f"{LAST_MEASURED}{k}" for k in kept)
        self.is_triggered = self.observer.trigger is not None or self.compares_always
        noisy = self.plant.p if self.observer.compares and self.plant.is_noisy else 0
        self.held_noise = tuple(f"{HELD_NOISE}{k}" for k in range(noisy))
        self.held = (*self.controls, *self.last_measured, *signals.held, *self.held_noise, LAST_SAMPLE)
        self.states = system.states
        self.names = ("t", *self.states, *self.held)
        self.size = len(self.states)
        elapsed = {"elapsed": Variable("t") - Variable(LAST_SAMPLE)}
        known = {name: row.substitute(elapsed) for name, row in self._estimate().items()}
        known |= {f"y.{k}": Variable(name) for k, name in enumerate(self.last_measured)}
        inputs = {name: signal.substitute(known) for name, signal in signals.continuous.items()}
        self._signal_values = {**inputs, **elapsed}
        self.visible = {name: Variable(name) for name in (*self.controls, *signals.held)} | inputs
        seen = [*(row for rows in self.observer.estimates.values() for row in rows), *self.observer.internals.values()]
        seen += [*(Variable(name) for name in self.controls), *inputs.values(), *map(Variable, signals.held)]
        seen += [expression for expression, _ in self.observer.stops]
        trigger = () if self.observer.trigger is None else (self.observer.trigger,)
        self.routines = {
            "flow": self._routine(system.flow),
            "measure": self._routine(system.measurement, signals.noise),
            "control": self._routine(tuple(self.observer.control.values())),
            "see": self._routine(seen),
            "trigger": self._routine(trigger),
        }
        there = {f"v.{k}": Variable(name) for k, name in enumerate(self.held_noise)}
        self._compare = self._routine([row.substitute(there) for row in system.compares]).arrays()
        measured = [f"y.{k}" for k in range(self.plant.p)]
        self.jumps = [self._routine(jump, measured) for jump in system.jumps]
        self.flow = self.routines["flow"].rows
        self._measure, self._control, self._see, self._trigger = (
            self.routines[name].arrays() for name in ("measure", "control", "see", "trigger")
        )
        self._jumps = [jump.arrays() for jump in self.jumps]

    @property
    def compares_always(self) -> bool:
        """Whether sensors compare their outputs all the time."""
        return bool(self.observer.compares) and self.observer.compared_always

    def _estimate(self) -> dict[str, Expression]:
        """What `hat.<state>` stands for in a signal: the estimate reported, or the middle of its bounds."""
        reported = self.observer.estimates
        rows = reported.get("x_hat")
        if rows is None and "x_lower" in reported and "x_upper" in reported:
            ends = zip(reported["x_lower"], reported["x_upper"], strict=True)
            rows = tuple((low + high) / Number(2) for low, high in ends)
        return {f"{ESTIMATE}{name}": row for name, row in zip(self.plant.states, rows or (), strict=False)}

    def closed(self, expression: Expression) -> Expression:
        """With the signals put in: over `names` and what is read at samples alone."""
        return expression.substitute(self._signal_values)

    def _routine(self, expressions: Sequence[Expression], further: Iterable[str] = ()) -> Routine:
        return Routine(tuple(self.closed(row) for row in expressions), self.names, tuple(further))

    def scalar_flow(self) -> Callable[..., tuple[float, ...]]:
        """f(t, *y, *held) over floats."""
        return compile_floats(self.flow, self.names, arrays=False)

    def array_flow(self) -> Callable[..., Array]:
        """f(t (R,), y (n, R), held (c, R)) -> (n, R), in `out` where that is given."""
        values = compile_floats(self.flow, self.names, arrays=True)

        def slope(t: Array, y: Array, held: Array, out: Array | None = None) -> Array:
            return stacked(values(t, *y, *held), y.shape[1], out)

        return slope

    def start(self, y: Array, box: tuple[Array, Array] | None, estimate: Array, x: Array) -> Array:
        """All states at t = 0, shape (size, R), from the first measurement (p, R), the known box of x(0)
        and the initial estimate (n, R)."""
        values = {f"initial.{name}": row for name, row in zip(self.plant.states, estimate, strict=True)}
        for side, rows in zip(("lower", "upper"), box or (), strict=False):
            values |= {f"{side}.{name}": row for name, row in zip(self.plant.states, rows, strict=True)}
        values |= {f"y.{k}": row for k, row in enumerate(y)}
        values |= dict.fromkeys(("t", LAST_SAMPLE), np.zeros(x.shape[1]))
        compiled = compile_floats([self.closed(row) for row in self.observer.start], tuple(values), arrays=True)
        return np.concatenate([x, stacked(compiled(*values.values()), x.shape[1])])

    def measure(self, t: Array, y: Array, held: Array, noise: Array) -> Array:
        return stacked(self._measure(t, *y, *held, *noise), len(t))

    def jump(self, which: Integers, t: Array, y: Array, held: Array, measured: Array) -> Array:
        """After samples that read what these numbers tell, shape (R,)."""
        numbers = np.unique(which)
        if len(numbers) == 1:
            return stacked(self._jumps[numbers[0]](t, *y, *held, *measured), len(t))
        after = np.empty_like(y)
        for number in numbers:
            of = np.flatnonzero(which == number)
            values = self._jumps[number](t[of], *y[:, of], *held[:, of], *measured[:, of])
            after[:, of] = stacked(values, len(of))
        return after

    @property
    def disturbance_rows(self) -> slice:
        """Where the disturbance stands in what is held."""
        start = len(self.controls) + len(self.last_measured)
        return slice(start, start + len(self.signals.held))

    @property
    def noise_rows(self) -> slice:
        """Where the noise of sensors that compare stands in what is held."""
        end = len(self.held) - 1
        return slice(end - len(self.held_noise), end)

    def hold(self, t: Array, y: Array, held: Array, measured: Array, d: Array) -> Array:
        """What is held from a sample at t on: the controlled inputs, evaluated after the jump, what was measured where
        an input reads it (last, where this sample does not read it), the disturbance d where it is drawn, the noise of
        sensors that compare as it was, and t itself."""
        start, count = len(self.controls), len(self.last_measured)
        seen = measured[:count]
        last = np.where(np.isnan(seen), held[start : start + count], seen)
        kept = np.concatenate([last, d, held[self.noise_rows], t[None]])
        since = np.concatenate([held[: len(self.controls)], kept])
        return np.concatenate([stacked(self._control(t, *y, *since), len(t)), kept])

    def trigger(self, t: Array, y: Array, held: Array) -> Array:
        """The trigger's value, shape (P,); of sensors that compare the largest."""
        if self.observer.compares:
            largest: Array = self.compared(t, y, held).max(axis=0)
            return largest
        value: Array = stacked(self._trigger(t, *y, *held), len(t))[0]
        return value

    def compared(self, t: Array, y: Array, held: Array) -> Array:
        """What each sensor compares, shape (p, P): it sends from 0 on."""
        return stacked(self._compare(t, *y, *held), len(t))

    def see(self, t: Array, y: Array, held: Array) -> View:
        values, place = stacked(self._see(t, *y, *held), len(t)), 0

        def take(count: int) -> Array:
            nonlocal place
            place += count
            return values[place - count : place]

        estimates = {name: take(len(rows)) for name, rows in self.observer.estimates.items()}
        internals = {name: take(1)[0] for name in self.observer.internals}
        named = (*self.controls, *self.signals.continuous, *self.signals.held)
        signals = {name: take(1)[0] for name in named}
        return View(y[: self.plant.n], estimates, internals, signals, take(len(self.observer.stops)))


def stacked(values: tuple[Any, ...], points: int, out: Array | None = None) -> Array:
    """Rows that may be plain numbers as one array (rows, points), `out` where that is given."""
    result = np.empty((len(values), points)) if out is None else out
    for row, value in zip(result, values, strict=True):
        row[:] = value
    return result
