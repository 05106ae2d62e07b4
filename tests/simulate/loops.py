"""Closed loops for the tests of the simulation, written by hand as equations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from cdobs_cli.exact.expression import Expression, Variable
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.hybrid import HybridSystem, Observer
from cdobs_cli.plant import Box, Input, Plant, Slopes
from cdobs_cli.run import SimulationPlan
from cdobs_cli.sampling import SamplingLaw


def read(text: str | float, names: Sequence[str]) -> Expression:
    """An expression over short names: `.` is written `__`."""
    known = {name.replace(".", "__"): Variable(name) for name in names}
    return parse(str(text), frozenset(), known)


def plant(
    states: Sequence[str], A: Any, phi: Sequence[str] = (), C: Any = None, *, law: SamplingLaw | None = None,
    inputs: Sequence[Input] = (),
    B: Any = None, **further: Any,
) -> Plant:  # fmt: skip
    n = len(states)
    names = [*states, *(source.name for source in inputs)]
    zero = ExactMatrix([[0] * n for _ in range(n)])
    rows = tuple(read(row, names) for row in (phi or ["0"] * n))
    C = C or [[1] + [0] * (n - 1)]
    return Plant(
        tuple(states), tuple(inputs), ExactMatrix(A), rows, None if B is None else ExactMatrix(B), ExactMatrix(C),
        Slopes(zero, zero),
        law or periodic("1"), **further,
    )  # fmt: skip


def periodic(period: str) -> SamplingLaw:
    return SamplingLaw.periodic(Exact(period))


def copy_observer(model: Plant, K: Sequence[str], **further: Any) -> HybridSystem:
    """x_hat+ = x_hat- + K (y - C x_hat-), flow a copy of the plant; one output."""
    hat = {name: Variable(f"hat.{name}") for name in model.states}
    innovation = Variable("y.0") - model.outputs("hat.")[0]
    jump = tuple(hat[name] + Exact(gain).expression * innovation for name, gain in zip(model.states, K, strict=True))
    observer = Observer(
        tuple(f"hat.{name}" for name in model.states), tuple(Variable(f"initial.{name}") for name in model.states),
        model.right_hand_side("hat."), jump, {"x_hat": tuple(hat.values())}, **further,
    )  # fmt: skip
    return HybridSystem(model, observer)


def pendulum(K: Sequence[str] = ("1", "1.8361"), period: str = "0.6", **further: Any) -> HybridSystem:
    """Dinh2014, Section IV, observer (3)."""
    return copy_observer(
        plant(("theta", "omega"), [[0, 1], [0, 0]], ("0", "sin(theta)"), law=periodic(period), **further), K
    )


def plan(
    horizon: str, initial_state: Sequence[Any] | None = None, estimate: Sequence[Any] | None = None, **further: Any
) -> SimulationPlan:
    signals: Mapping[str, str] = further.pop("signals", {})
    times = further.pop("sampling_times", None)
    return SimulationPlan(
        Exact(horizon), exact(initial_state), initial_estimate=exact(estimate),
        signals={name: text if isinstance(text, Expression) else read(text, ["t"]) for name, text in signals.items()},
        sampling_times=None if times is None else read(times, ["t"]), **further,
    )  # fmt: skip


def exact(values: Sequence[Any] | None) -> tuple[Exact, ...] | None:
    return None if values is None else tuple(Exact(str(value)) for value in values)


def box(lower: Sequence[Any], upper: Sequence[Any]) -> Box:
    return Box(exact(lower) or (), exact(upper) or ())
