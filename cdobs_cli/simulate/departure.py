"""Leaving the domain: which state or estimate, when, at which value, and how far beyond its limit it comes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from cdobs_cli.arrays import Array, Booleans, Integers
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.expression import Expression, Variable
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.plant import Domain, Interval
from cdobs_cli.records import dataclass
from cdobs_cli.run import Departure
from cdobs_cli.simulate.loop import stacked

LARGEST = float(np.finfo(float).max)  # stands for infinity, which JSON does not have
_ROUNDING = 1e-9  # of the larger end of an interval, and of a condition `w >= 0`: beyond it by less is on it
_WAY_BACK = 1e-12  # what a change of coordinates and back may add


@dataclass(frozen=True)
class Limit:
    """lower <= value <= upper, up to a slack; `text` says it as the user typed it."""

    what: str
    value: Expression
    lower: float
    upper: float
    slack: float
    text: str


def _limits(domain: Domain, values: Mapping[str, Expression], prefix: str = "", least: float = 0.0) -> list[Limit]:
    """The limits of a domain, over what its states are made of."""
    limits = []
    for name, interval in domain.box.items():
        low = -np.inf if interval.lower is None else float(interval.lower)
        high = np.inf if interval.upper is None else float(interval.upper)
        slack = max(least, _ROUNDING * max((abs(end) for end in (low, high) if np.isfinite(end)), default=0.0))
        limits.append(Limit(f"{prefix}{name}", values[name], low, high, slack, _allowed(interval)))
    for condition in domain.where:
        value = condition.substitute(values)
        limits.append(Limit(f"{prefix}{condition}", value, 0.0, np.inf, _ROUNDING, "at least 0"))
    return limits


def _allowed(interval: Interval) -> str:
    """`-1 to 1`, `at least -1`, `at most 1`."""
    if interval.lower is not None and interval.upper is not None:
        return f"{interval.lower} to {interval.upper}"
    return f"at least {interval.lower}" if interval.lower is not None else f"at most {interval.upper}"


class Limits:
    """What must stay where along a run: the plant's states, in the user's coordinates, and the estimate where nothing
    keeps it where the slopes hold."""

    def __init__(self, system: HybridSystem) -> None:
        states, plant = system.plant.states, system.plant
        own: dict[str, Expression] = {name: Variable(name) for name in states}
        typed, stays = system.original, system.estimate_must_stay
        at_x = _limits(plant.domain, own) if typed is None else _limits(typed.domain, typed.inverse, least=_WAY_BACK)
        at_x_hat = _limits(plant.domain, own, "the estimate of ") if stays else []
        self.groups = (at_x, at_x_hat)
        self.limits = (*at_x, *at_x_hat)
        self._values = [_compiled(limits, states) for limits in (at_x, at_x_hat)]
        ends = ("lower", "upper", "slack")
        self._ends = [np.array([[getattr(one, end)] for one in self.limits]) for end in ends]

    def __bool__(self) -> bool:
        return bool(self.limits)

    def values(self, x: Array, x_hat: Array | None) -> Array:
        """Of each limit at points, shape (limits, P); nan where there is no estimate."""
        at_x, at_x_hat = self._values
        states = at_x(x)
        if x_hat is not None:
            return np.concatenate([states, at_x_hat(x_hat)])
        return np.concatenate([states, np.full((len(self.limits) - len(states), x.shape[1]), np.nan)])

    def excess(self, values: Array) -> Array:
        """How far beyond its limit each value is, -inf where it is not, up to rounding; shape (limits, P)."""
        lower, upper, slack = self._ends
        beyond: Array = np.maximum(lower - values, values - upper)
        return np.where(beyond > slack, beyond, -np.inf)


def _compiled(limits: Sequence[Limit], names: tuple[str, ...]) -> Callable[[Array], Array]:
    function: Callable[..., Any] = compile_floats([one.value for one in limits], names, arrays=True)
    return lambda rows: stacked(function(*rows), rows.shape[1])


class Departures:
    """The first departure of each run, from looks at its points in any order."""

    def __init__(self, limits: Limits, runs: int) -> None:
        self.limits = limits
        self.first = np.full(runs, np.inf)
        self.which, self.value = np.zeros(runs, dtype=np.int64), np.zeros(runs)
        self.beyond = np.full((len(limits.limits), runs), -np.inf)

    def look(self, runs: Integers, t: Array, x: Array, x_hat: Array | None) -> None:
        """Points (P,), in the order of time for each run."""
        if not self.limits or not len(runs):
            return
        values = self.limits.values(x, x_hat)
        excess = self.limits.excess(values)
        outside: Booleans = excess.max(axis=0) > 0
        if not outside.any():
            return
        for row, own in zip(self.beyond, excess, strict=True):
            np.maximum.at(row, runs, own)
        points = np.flatnonzero(outside)
        left, first = np.unique(runs[points], return_index=True)
        for run, point in zip(left, points[first], strict=True):
            if t[point] < self.first[run]:
                which = int(np.argmax(excess[:, point]))
                self.first[run], self.which[run], self.value[run] = t[point], which, values[which, point]

    def take(self, first: Array, which: Integers, value: Array, beyond: Array) -> None:
        """What somebody else has seen of all runs; `beyond` may lack limits that nothing was seen of."""
        self.first, self.which, self.value = first, which, value
        self.beyond[: len(beyond)] = beyond

    def of(self, run: int) -> Departure | None:
        if not np.isfinite(self.first[run]):
            return None
        which = int(self.which[run])
        limit, beyond = self.limits.limits[which], self.beyond[which, run]
        value, beyond = (float(np.clip(one, -LARGEST, LARGEST)) for one in (self.value[run], beyond))
        return Departure(limit.what, float(self.first[run]), value, limit.text, beyond)
