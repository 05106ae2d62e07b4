"""What is typed of a simulation against what is declared of the plant: a start outside the domain, a signal outside its
range. Only what is certain is told; the rest is seen by the run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from math import inf, nan

from cdobs_cli.errors import Problem
from cdobs_cli.exact.budget import spend
from cdobs_cli.exact.compiled import Compiled, compile_floats
from cdobs_cli.exact.draws import is_random, with_draws
from cdobs_cli.exact.expression import Expression, ExpressionError
from cdobs_cli.exact.numbers import Exact, decimal_text
from cdobs_cli.fields import LARGEST
from cdobs_cli.plant import Domain, Interval, Plant, TypedDynamics
from cdobs_cli.run import SimulationPlan
from cdobs_cli.spec.reader import FieldPath

PIECES = 16  # of the horizon, over which a signal is enclosed
_RANGE_COST = 30  # operations, for each node of an expression
Piece = tuple[Fraction, Fraction]


def limit_problems(plant: Plant | TypedDynamics, plan: SimulationPlan) -> Iterator[Problem]:
    """Of a simulation typed in the plant's own states."""
    at: FieldPath = ("simulation",)
    domain, names = plant.domain, plant.states
    if plan.initial_state is not None:
        yield from _outside(domain, names, plan.initial_state, (*at, "initial_state"))
    if plan.initial_box is not None:
        yield from _box_outside(domain, names, (plan.initial_box.lower, plan.initial_box.upper), (*at, "initial_box"))
    for name, interval in declared_ranges(plant).items():
        if name in plan.signals:
            letter, _, index = name.partition(".")
            signal: FieldPath = (*at, "signals", letter, *((int(index),) if index else ()))
            yield from _signal_outside(plan.signals[name], interval, plan.horizon, signal)


def declared_ranges(plant: Plant | TypedDynamics) -> dict[str, Interval]:
    """Where the signals lie, by name; a disturbance in the plant's own states alone."""
    ranges = {source.name: source.range for source in plant.inputs if source.range is not None}
    moved = isinstance(plant, TypedDynamics) and plant.coordinates is not None
    for letter, box in (("d", None if moved else plant.disturbance), ("v", plant.noise)):
        ends = zip(box.lower, box.upper, strict=True) if box is not None else ()
        ranges |= {f"{letter}.{i}": Interval(*pair) for i, pair in enumerate(ends)}
    return ranges


def is_outside(value: Exact, interval: Interval) -> bool:
    """For certain."""
    below = interval.lower is not None and (value - interval.lower).sign() == -1
    return below or (interval.upper is not None and (interval.upper - value).sign() == -1)


def _outside(domain: Domain, names: Sequence[str], x: Sequence[Exact], at: FieldPath) -> Iterator[Problem]:
    for i, (name, value) in enumerate(zip(names, x, strict=True)):
        interval = domain.box.get(name)
        if interval is not None and is_outside(value, interval):
            yield Problem((*at, i), "lies outside the domain", f"{name} = {value}", f"{name} in {interval}")
    for condition in domain.where:
        value = _value(condition, names, x)
        if value.sign() == -1:
            yield Problem(at, "lies outside the domain", f"{condition} = {value}", f"{condition} >= 0")


def _box_outside(
    domain: Domain, names: Sequence[str], ends: tuple[Sequence[Exact], ...], at: FieldPath
) -> Iterator[Problem]:
    for side, end in zip(("lower", "upper"), ends, strict=True):
        yield from _outside(Domain(domain.box), names, end, (*at, side))
    for condition in domain.where:
        # The corner where an affine function is least.
        rises = [Exact(condition.derivative(name)).sign() == 1 for name in names]
        corner = [low if up else high for up, low, high in zip(rises, *ends, strict=True)]
        yield from _outside(Domain(where=(condition,)), names, corner, at)


def _value(condition: Expression, names: Sequence[str], x: Sequence[Exact]) -> Exact:
    return Exact(condition.substitute({name: one.expression for name, one in zip(names, x, strict=True)}))


def _signal_outside(signal: Expression, interval: Interval, horizon: Exact, at: FieldPath) -> Iterator[Problem]:
    what = "the signal leaves its declared interval"
    try:
        if not signal.variables and not is_random(signal):
            if is_outside(Exact(signal), interval):
                yield Problem(at, what, str(signal), str(interval))
        elif signal.variables <= {"t"} and (where := _first_outside(signal, interval, float(horizon))) is not None:
            yield Problem(at, what, where, str(interval))
    except (ExpressionError, ZeroDivisionError, OverflowError):  # no value: the run says where
        return


def _first_outside(signal: Expression, interval: Interval, horizon: float) -> str | None:
    """The first piece of [0, horizon] on which all values lie outside, in words."""
    draws: list[str] = []
    closed = with_draws(signal, draws)
    step = Fraction(horizon) / PIECES
    pieces = [(k * step, (k + 1) * step) for k in range(PIECES)]
    for first, last in _suspects(closed, interval, pieces, draws):
        low, high = _values(closed, first, last, draws)
        above, below = Interval(None, interval.upper), Interval(interval.lower, None)
        if is_outside(Exact(low), above) or is_outside(Exact(high), below):
            ends = " to ".join(decimal_text(end, 6) for end in (low, high))
            return f"{ends} for t in [{decimal_text(first, 6)}, {decimal_text(last, 6)}]"
    return None


def _suspects(signal: Expression, interval: Interval, pieces: list[Piece], draws: list[str]) -> list[Piece]:
    """The pieces whose middle is outside in floats: no other can be outside all along, and most specs have none."""
    function = compile_floats([signal], ["t", *(f"draw.{k}" for k in range(len(draws)))], arrays=False)
    low = -inf if interval.lower is None else float(interval.lower)
    high = inf if interval.upper is None else float(interval.upper)
    drawn = [0.5 if kind == "uniform" else 0.0 for kind in draws]
    return [piece for piece in pieces if not low <= _float(function, float(sum(piece) / 2), drawn) <= high]


def _float(function: Compiled, t: float, drawn: list[float]) -> float:
    """Not a number where there is no value, or none that a float can hold."""
    try:
        value = function(t, *drawn)[0]
    except (ArithmeticError, ValueError):
        return nan
    return nan if isinstance(value, complex) else float(value)


def _values(signal: Expression, first: Fraction, last: Fraction, draws: list[str]) -> tuple[Fraction, Fraction]:
    """Proved ends of the values over a piece of time; infinite ends as numbers beyond all that may be typed."""
    from cdobs_cli.bounds.ranges import LINE, Range, range_of

    spend(_RANGE_COST * signal.size)
    unit = Range.point(0).hull(Range.point(1))
    drawn = {f"draw.{k}": unit if kind == "uniform" else LINE for k, kind in enumerate(draws)}
    values = range_of(signal, drawn | {"t": Range(first, last)})
    lower, upper = (LARGEST * (1 if end > 0 else -1) if isinstance(end, float) else end
                    for end in (values.lower, values.upper))  # fmt: skip
    return lower, upper
