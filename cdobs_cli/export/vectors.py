"""A simulated run as a list of calls with what the estimate should be after each: what exported code is compared with.

Inputs are held from one sample to the next, as an exported observer holds them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from itertools import takewhile
from math import isfinite
from typing import Literal

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.exact.expression import Number
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.export.portable import Portable
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.records import dataclass
from cdobs_cli.run import ESTIMATE, SimulationPlan, Trajectory
from cdobs_cli.sampling import SamplingLaw

MOST_SAMPLES = 40
TOLERANCE = 1e-9  # of the largest size of an estimate, at least of 1
ROOM = 4.0  # of the distance that was measured of the integration, where that is larger
_AROUND = 1e-3  # of the time to a sample that is asked for: how long before and after it is asked whether it is due
Kind = Literal["predict", "correct", "sample", "arrive", "asks"]


@dataclass(frozen=True)
class Call:
    """predict over dt with u; correct number `which` with y; sample: its value comes later; arrive: of sensor number
    `which`, of sample number `ticket`; asks: whether a sample would be due dt later, and `which` is the answer.

    expected: all estimates after it, empty where they are not known; control: inputs that the observer sets then.
    """

    kind: Kind
    which: int = 0
    dt: float = 0.0
    u: tuple[float, ...] = ()
    y: tuple[float, ...] = ()
    ticket: int = 0
    expected: tuple[float, ...] = ()
    control: tuple[float, ...] = ()


@dataclass(frozen=True)
class Vectors:
    """start: the initial estimate, or the lower and the upper ends of the box. scale: of each estimate, its largest
    size or 1."""

    start: tuple[float, ...]
    calls: tuple[Call, ...]
    scale: tuple[float, ...]


def allowed(accuracy: float | None) -> float:
    """How far replayed estimates may be from the simulated ones, where that was measured as closely as this."""
    return TOLERANCE if accuracy is None or accuracy <= TOLERANCE else ROOM * accuracy


def held(system: HybridSystem, plan: SimulationPlan, law: SamplingLaw) -> tuple[HybridSystem, SimulationPlan]:
    """One run of the system, of so many samples at most, with inputs held from sample to sample. Where measurements
    arrive late they stay as they are at t = 0."""
    period, most = float(law.T_max), Exact(MOST_SAMPLES)
    is_long = period > 0 and float(plan.horizon) > MOST_SAMPLES * period
    signals = {name: one for name, one in plan.signals.items() if name not in plan.inputs}
    if system.plant.delays:
        signals |= {name: one.substitute({"t": Number(0)}) for name, one in plan.inputs.items()}
    else:
        system = _with_held_inputs(system, plan)
    return system, replace(plan, runs=1, horizon=law.T_max * most if is_long else plan.horizon, signals=signals)


def _with_held_inputs(system: HybridSystem, plan: SimulationPlan) -> HybridSystem:
    reported, half = system.observer.estimates, Number(Fraction(1, 2))
    rows = reported.get("x_hat")
    if rows is None:
        ends = zip(reported["x_lower"], reported["x_upper"], strict=True)
        rows = tuple((low + high) * half for low, high in ends)
    estimates = dict(zip(system.plant.states, rows, strict=True))
    known = {f"{ESTIMATE}{name}": row for name, row in estimates.items()}
    known |= {f"y.{k}": row.substitute(estimates) for k, row in enumerate(system.plant.outputs())}
    own = {name: row.substitute(known) for name, row in plan.inputs.items() if name not in system.observer.control}
    return replace(system, observer=replace(system.observer, control={**own, **system.observer.control}))


def vectors(portable: Portable, plan: SimulationPlan, seen: Trajectory, n: int) -> Vectors:
    """The calls of a run of `held`, of a plant of n states."""
    calls = tuple(takewhile(_is_finite, _late(portable, seen) if portable.late else _at_once(portable, seen)))
    expected = np.array([call.expected for call in calls if call.expected]).reshape(-1, len(portable.rows))
    largest = np.abs(expected).max(axis=0, initial=1.0)
    return Vectors(_start(portable, plan, n), calls, tuple(largest.tolist()))


def _is_finite(call: Call) -> bool:
    """Whether floats hold it: a run that diverges is followed as long as they do."""
    return all(map(isfinite, (*call.u, *call.y, *call.expected, *call.control)))


def _start(portable: Portable, plan: SimulationPlan, n: int) -> tuple[float, ...]:
    box = plan.initial_box
    if portable.starts_from_box:
        assert box is not None
        return tuple(map(float, (*box.lower, *box.upper)))
    middle = None if box is None else box.middle
    given = plan.initial_estimate or middle or (Exact(0),) * n
    return tuple(map(float, given))


def _at_once(portable: Portable, seen: Trajectory) -> Iterator[Call]:
    now = 0.0
    u = _inputs(portable, seen, 0)
    for k, t in enumerate(seen.t_k[:MOST_SAMPLES].tolist()):
        first, last = _sides(seen, t)
        if t > now:
            yield from _flown(portable, t - now, u, _estimates(portable, seen, first))
        if k or portable.first_sample:
            which, y = _read(portable, seen.y_k[k])
            before, after = _inputs(portable, seen, first), _inputs(portable, seen, last)
            another = k + 1 < len(seen.t_k) and seen.t_k[k + 1] == t  # only the last of them is seen
            told = () if another else _estimates(portable, seen, last)
            names = list(portable.inputs)
            control = () if another else tuple(after[names.index(name)] for name in portable.control)
            yield Call("correct", which, u=before, y=y, expected=told, control=control)
        u, now = _inputs(portable, seen, last), t
    end = float(seen.t[-1])
    if len(seen.t_k) <= MOST_SAMPLES and end > now:
        yield Call("predict", dt=end - now, u=u, expected=_estimates(portable, seen, len(seen.t) - 1))


def _flown(portable: Portable, dt: float, u: tuple[float, ...], expected: tuple[float, ...]) -> Iterator[Call]:
    """Up to a sample; where the observer chooses it, asked shortly before and shortly after."""
    if portable.trigger is not None:
        yield Call("asks", 0, dt=dt * (1 - _AROUND), u=u)
        yield Call("asks", 1, dt=dt * (1 + _AROUND), u=u)
    yield Call("predict", dt=dt, u=u, expected=expected)


def _read(portable: Portable, measured: Array) -> tuple[int, tuple[float, ...]]:
    """Which correction it is, and what is read."""
    there = {int(k) for k in np.flatnonzero(~np.isnan(measured))}
    which = next(k for k, one in enumerate(portable.corrections) if set(one.outputs) == there)
    return which, tuple(float(measured[k]) for k in portable.corrections[which].outputs)


def _late(portable: Portable, seen: Trajectory) -> Iterator[Call]:
    """Samples and arrivals in the order of time; of equal times the arrivals of older samples come first."""
    assert portable.late is not None and seen.arrival_k is not None
    events: list[tuple[float, int, int, int]] = []
    last = float(seen.t_k[:MOST_SAMPLES][-1])
    for k, t in enumerate(seen.t_k[:MOST_SAMPLES].tolist()):
        events.append((t, 1, k, 0))
        for which, (_, outputs) in enumerate(portable.late.sensors):
            arrival = float(seen.arrival_k[k, outputs[0]])
            if arrival <= last:
                events.append((arrival, 2 if arrival == t else 0, k, which))
    events.sort()
    now, u = 0.0, _inputs(portable, seen, 0)
    for number, (t, order, k, which) in enumerate(events):
        first, after = _sides(seen, t)
        if t > now:
            yield Call("predict", dt=t - now, u=u, expected=_estimates(portable, seen, first))
        done = number + 1 == len(events) or events[number + 1][0] > t
        told = _estimates(portable, seen, after) if done else ()
        if order == 1:
            yield Call("sample", ticket=k, u=u, expected=told)
        else:
            y = tuple(float(seen.y_k[k, one]) for one in portable.late.sensors[which][1])
            yield Call("arrive", which, y=y, ticket=k, expected=told)
        now = t


def _sides(seen: Trajectory, t: float) -> tuple[int, int]:
    """Before and after what happens at a time."""
    at = np.flatnonzero(seen.t == t)
    return int(at[0]), int(at[-1])


def _estimates(portable: Portable, seen: Trajectory, at: int) -> tuple[float, ...]:
    return tuple(float(value) for name in portable.estimates for value in seen.estimates[name][at])


def _inputs(portable: Portable, seen: Trajectory, at: int) -> tuple[float, ...]:
    return tuple(float(seen.inputs[name][at]) for name in portable.inputs)
