"""A counterexample of an enclosure run again: plant and observer from the witness's box of x(0), sampled by its word of
periods, under its disturbance and noise, up to where a bound has crossed the state.

    d(t) = d_k for t_k <= t < t_(k+1),    y_k = C x(t_k) + v_k
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from numpy.typing import NDArray

from cdobs_cli.certificate import Witness
from cdobs_cli.errors import UsageError
from cdobs_cli.exact.expression import Expression, ExpressionError, Number, Variable, call
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.plant import Box
from cdobs_cli.records import dataclass
from cdobs_cli.run import Run, SimulationPlan
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.engine import simulate


@dataclass(frozen=True)
class BoxReplay:
    """The run of a witness of kind `box`, and the distance of the state from its bound that was proved at its end."""

    run: Run
    bound: str
    proved: str

    def arrays(self) -> dict[str, NDArray[Any]]:
        """t (N,), x, x_lower, x_upper (N, n), t_k (K,), y_k (K, p)."""
        first = self.run.trajectories[0]
        return {"t": first.t, "x": first.x, **first.estimates, "t_k": first.t_k, "y_k": first.y_k}

    def document(self) -> dict[str, Any]:
        """The figures of the run."""
        first = self.run.trajectories[0]
        return {
            "samples": len(first.t_k), "horizon": float(first.t[-1]), "bound": self.bound,
            "distance_proved": self.proved, "inclusion_margin": self.run.overall.inclusion_margin,
        }  # fmt: skip


def replay_box(system: HybridSystem, law: SamplingLaw, witness: Witness) -> BoxReplay:
    """Run a witness of kind `box`.

    Raises:
        UsageError: another kind of witness, or one that cannot be read.
    """
    if witness.kind != "box":
        raise UsageError(f"a witness of kind {witness.kind} has no box of x(0) to start from")
    try:
        plan = _plan(system, law, witness)
        bound, proved = str(witness.data["bound"]), str(witness.data["distance"])
    except (ValueError, KeyError, TypeError, IndexError, ExpressionError) as error:
        raise UsageError(f"a witness that cannot be read: {error}") from error
    return BoxReplay(simulate(system, plan, law), bound, proved)


def _plan(system: HybridSystem, law: SamplingLaw, witness: Witness) -> SimulationPlan:
    data = witness.data
    periods = [Exact(text) for text in witness.times]
    after = Exact(data["after"])
    signals: dict[str, Expression] = {}
    for letter, name in (("d", "disturbance"), ("v", "noise")):
        box = getattr(system.plant, name)
        for i in range(0 if box is None else len(box.lower)):
            signals[f"{letter}.{i}"] = _steps([Exact(row[i]) for row in data[name]], periods, early=letter == "v")
    horizon = after
    for T in periods:
        horizon = horizon + T
    return SimulationPlan(
        horizon, _vector(data["state"]), Box(_vector(data["lower"]), _vector(data["upper"])), signals=signals,
        sampling_times=_steps([*periods, law.T_max], periods, early=True),
    )  # fmt: skip


def _vector(texts: list[str]) -> tuple[Exact, ...]:
    return tuple(Exact(text) for text in texts)


def _steps(values: list[Exact], periods: list[Exact], *, early: bool) -> Expression:
    """value_k from t_k on; where only its values at samples count, from half a period earlier."""
    total: Expression = values[0].expression
    at: Exact = Exact(0)
    for k, T in enumerate(periods):
        at = at + T
        since = Variable("t") - at.expression
        if early:
            since = since + T.expression * Number(Fraction(1, 2))
        total = total + (values[k + 1] - values[k]).expression * call("step", since)
    return total
