"""Signals as expressions of t: inputs, disturbances `d.i`, and noise `v.k` drawn at samples.

Each run has its own random streams, made from (seed, run, purpose): what run 7 sees does not depend on how
many runs there are, nor on how far the others got.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from cdobs_cli.arrays import Array, Booleans, Integers
from cdobs_cli.errors import Problem, SpecError
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.draws import is_random, with_draws
from cdobs_cli.exact.expression import ZERO, Expression
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.plant import Plant
from cdobs_cli.run import ESTIMATE

_PURPOSES = {"initial": 0, "periods": 1, "noise": 2}


@dataclass(frozen=True)
class Range:
    """Where a signal must stay."""

    name: str
    lower: float
    upper: float

    def holds(self, values: Array) -> Booleans:
        """Which values stay; a signal may touch its ends, up to rounding."""
        slack = 1e-9 * max((abs(end) for end in (self.lower, self.upper) if abs(end) < np.inf), default=0.0)
        inside: Booleans = (values >= self.lower - slack) & (values <= self.upper + slack)
        return inside


@dataclass(frozen=True)
class Signals:
    """Every signal of a simulation, closed: expressions of `t` (and `draw.0`, .. in noise), inputs also of the estimate
    `hat.<state>` and of the last measurement `y.0`, ...

    Attributes:
        continuous: inputs that no controller sets, and `d.i`.
        noise: `v.0`, `v.1`, ..; empty where the plant declares none.
        draws: the standard random variables that noise uses, in order of `draw.k`.
        ranges: declared intervals of continuous signals and of noise.
        held_ranges: declared intervals of inputs that a controller or feedback sets: a run that leaves them ends.
    """

    continuous: Mapping[str, Expression]
    noise: Mapping[str, Expression]
    draws: tuple[str, ...]
    ranges: tuple[Range, ...]
    held_ranges: tuple[Range, ...]

    @staticmethod
    def of(plant: Plant, typed: Mapping[str, Expression], controlled: Iterable[str]) -> Signals:
        """A signal that is not given is 0; one for an input that the controller sets can only be 0.

        Raises:
            SpecError: a signal that nothing reads, or that is random between samples.
        """
        controlled = set(controlled)
        # A spec names a signal for every input; for one that the controller sets, 0 says that nothing is added.
        typed = {name: signal for name, signal in typed.items() if not (name in controlled and signal == ZERO)}
        names = [source.name for source in plant.inputs if source.name not in controlled]
        if plant.disturbance is not None:
            names += [f"d.{i}" for i in range(plant.n)]
        noisy = [f"v.{k}" for k in range(plant.p)] if plant.noise is not None else []
        read, unread = ", ".join([*names, *noisy]) or None, "a signal that nothing reads"
        problems = [
            Problem(_field(name), unread, name, read, _why_unread(name, controlled))
            for name in typed
            if name not in names and name not in noisy
        ]
        continuous = {name: typed.get(name, ZERO) for name in names}
        random = "only noise, which is drawn at samples, may be random"
        problems += [
            Problem(_field(name), random, str(signal), "an expression of t")
            for name, signal in continuous.items()
            if is_random(signal)
        ]
        draws: list[str] = []
        noise = {name: with_draws(typed.get(name, ZERO), draws) for name in noisy}
        fed = fed_back(continuous, names[: len(names) if plant.disturbance is None else -plant.n])
        known = {"t", *(f"{ESTIMATE}{name}" for name in plant.states), *(f"y.{k}" for k in range(plant.p))}
        problems += [
            Problem(_field(name), "a signal is an expression of t", str(signal), "t")
            for name, signal in {**continuous, **noise}.items()
            if {variable for variable in signal.variables if not variable.startswith("draw.")}
            - (known if name in fed else {"t"})
        ]
        if problems:
            raise SpecError(tuple(problems))
        ranges = [_range(one.name, one.range.lower, one.range.upper) for one in plant.inputs if one.range is not None]
        held = tuple(one for one in ranges if one.name in controlled | fed)
        for letter, box in (("d", plant.disturbance), ("v", plant.noise)):
            ends = zip(box.lower, box.upper, strict=True) if box is not None else ()
            ranges += [_range(f"{letter}.{i}", *pair) for i, pair in enumerate(ends)]
        return Signals(continuous, noise, tuple(draws), tuple(one for one in ranges if one not in held), held)

    @property
    def reads_measurements(self) -> bool:
        """Whether an input is a function of the last measurement."""
        return any(name.startswith("y.") for signal in self.continuous.values() for name in signal.variables)

    def refuse_outside(self, t: Array, values: Mapping[str, Array]) -> None:
        """Raises: SpecError at the first time a signal is outside its declared interval.

        t (P,); values by name (P,).
        """
        for interval in self.ranges:
            if interval.name not in values:
                continue
            value = values[interval.name]
            inside = interval.holds(value)
            if not np.all(inside):
                first = int(np.argmin(np.where(inside, np.inf, t)))
                got = f"{float(value[first]):.9g} at t = {float(t[first]):.9g}"
                allowed = f"[{interval.lower:.9g}, {interval.upper:.9g}]"
                raise SpecError.at(_field(interval.name), "the signal leaves its declared interval", got, allowed)


def fed_back(signals: Mapping[str, Expression], inputs: Iterable[str]) -> set[str]:
    """The inputs whose signal reads the estimate or the last measurement."""
    return {name for name in inputs if signals[name].variables - {"t"}}


class Draws:
    """Random numbers by (run, purpose), as many as each run has asked for so far."""

    def __init__(self, seed: int, runs: int) -> None:
        self.seed, self.runs = seed, runs
        self._streams: dict[tuple[str, int], list[np.random.Generator]] = {}
        self._tables: dict[tuple[str, int], Array] = {}

    def at(self, purpose: str, kind: str, channel: int, runs: Integers, index: int) -> Array:
        """The number `index` of each given run: uniform on [0, 1) or standard normal, shape (len(runs),)."""
        key = (purpose, channel)
        if key not in self._streams:
            keys = [(run, _PURPOSES[purpose], channel) for run in range(self.runs)]
            seeds = [np.random.SeedSequence(self.seed, spawn_key=key) for key in keys]
            self._streams[purpose, channel] = [np.random.default_rng(seed) for seed in seeds]
            self._tables[key] = np.empty((self.runs, 0))
        while index >= self._tables[key].shape[1]:
            count = max(8, self._tables[key].shape[1])
            draw = np.random.Generator.random if kind == "uniform" else np.random.Generator.standard_normal
            block = np.array([draw(stream, count) for stream in self._streams[key]])
            self._tables[key] = np.concatenate([self._tables[key], block], axis=1)
        numbers: Array = self._tables[key][runs, index]
        return numbers


class Noise:
    """v_k at samples."""

    def __init__(self, signals: Signals, draws: Draws) -> None:
        self.signals, self.draws = signals, draws
        names = ["t", *(f"draw.{k}" for k in range(len(signals.draws)))]
        self._values = compile_floats(list(signals.noise.values()), names, arrays=True)

    def at(self, runs: Integers, index: int, t: Array) -> Array:
        """Noise of sample number `index` of each given run, at its time: shape (p, len(runs)), or (0, ..)."""
        drawn = [self.draws.at("noise", kind, channel, runs, index) for channel, kind in enumerate(self.signals.draws)]
        values = [np.broadcast_to(value, t.shape) for value in self._values(t, *drawn)]
        self.signals.refuse_outside(t, dict(zip(self.signals.noise, values, strict=True)))
        return np.array(values).reshape(len(values), len(t))


def _range(name: str, lower: Exact | None, upper: Exact | None) -> Range:
    return Range(
        name, float("-inf") if lower is None else float(lower), float("inf") if upper is None else float(upper)
    )


def _field(name: str) -> tuple[str | int, ...]:
    letter, _, index = name.partition(".")
    return ("simulation", "signals", letter, int(index)) if index.isdigit() else ("simulation", "signals", name)


def _why_unread(name: str, controlled: set[str]) -> str | None:
    if name in controlled:
        return "this input is set by the observer's controller"
    if name.startswith("d."):
        return "declare plant.disturbance"
    return "declare measurement.noise" if name.startswith("v.") else None
