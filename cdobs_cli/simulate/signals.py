"""Signals: inputs, disturbances `d.i`, and noise `v.k` at samples; as typed, or drawn within what is declared.

Each run has its own random streams, made from (seed, run, purpose): what run 7 sees does not depend on how
many runs there are, nor on how far the others got.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction

import numpy as np

from cdobs_cli.arrays import Array, Booleans, Integers
from cdobs_cli.errors import Problem, SpecError
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.draws import is_random, with_draws
from cdobs_cli.exact.expression import ZERO, Expression, Number, Variable, call
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.plant import Box, Plant
from cdobs_cli.records import dataclass
from cdobs_cli.run import ESTIMATE

_PURPOSES = {"initial": 0, "periods": 1, "noise": 2, "disturbance": 3, "delays": 4}


@dataclass(frozen=True)
class Range:
    """Where a signal must stay."""

    name: str
    lower: float
    upper: float

    @property
    def ends(self) -> tuple[float, float]:
        """A signal may touch its ends, up to rounding."""
        slack = 1e-9 * max((abs(end) for end in (self.lower, self.upper) if abs(end) < np.inf), default=0.0)
        return self.lower - slack, self.upper + slack

    def holds(self, values: Array) -> Booleans:
        """Which values stay."""
        low, high = self.ends
        inside: Booleans = (values >= low) & (values <= high)
        return inside


@dataclass(frozen=True)
class Signals:
    """Every signal of a simulation, closed: expressions of `t` (and `draw.0`, .. in noise), inputs also of the estimate
    `hat.<state>` and of the last measurement `y.0`, ...

    Attributes:
        continuous: inputs that no controller sets, and `d.i` where they are typed.
        held: names of `d.i` where none is typed: within `disturbance_box` (lower, upper; (n, 1)), or white.
        noise: `v.0`, `v.1`, ..; empty where the plant declares none. Uniform in its box, or normal, if none is typed.
        draws: the standard random variables that noise uses, in order of `draw.k`.
        ranges: declared intervals of continuous signals and of noise.
        held_ranges: declared intervals of inputs that a controller or feedback sets: a run that leaves them ends.
    """

    continuous: Mapping[str, Expression]
    noise: Mapping[str, Expression]
    draws: tuple[str, ...]
    ranges: tuple[Range, ...]
    held_ranges: tuple[Range, ...]
    held: tuple[str, ...] = ()
    disturbance_box: tuple[Array, Array] | None = None
    intensity: ExactMatrix | None = None

    @staticmethod
    def of(plant: Plant, typed: Mapping[str, Expression], controlled: Iterable[str]) -> Signals:
        """An input that is not given is 0; one that the controller sets can only be 0. Disturbance and noise are drawn
        within what is declared unless one of their components is typed: the others are 0 then.

        Raises:
            SpecError: a signal that nothing reads, or that is random between samples.
        """
        controlled = set(controlled)
        # A spec names a signal for every input; for one that the controller sets, 0 says that nothing is added.
        typed = {name: signal for name, signal in typed.items() if not (name in controlled and signal == ZERO)}
        inputs = [source.name for source in plant.inputs if source.name not in controlled]
        disturbed = [f"d.{i}" for i in range(plant.n)] if plant.is_disturbed else []
        noisy = [f"v.{k}" for k in range(plant.p)] if plant.is_noisy else []
        known_names = [*inputs, *disturbed, *noisy]
        read, unread = ", ".join(known_names) or None, "a signal that nothing reads"
        problems = [
            Problem(_field(name), unread, name, read, _why_unread(name, controlled))
            for name in typed
            if name not in known_names
        ]
        held = () if typed.keys() & disturbed else tuple(disturbed)
        continuous = {name: typed.get(name, ZERO) for name in (*inputs, *(() if held else disturbed))}
        random = "only noise, which is drawn at samples, may be random"
        problems += [
            Problem(_field(name), random, str(signal), "an expression of t")
            for name, signal in continuous.items()
            if is_random(signal)
        ]
        draws: list[str] = []
        drawn = {} if typed.keys() & noisy else _declared_noise(plant)
        noise = {name: with_draws(typed.get(name, drawn.get(name, ZERO)), draws) for name in noisy}
        if plant.covariance is not None and drawn:
            draws = ["normal"] * plant.p
        fed = fed_back(continuous, inputs)
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
        kept = tuple(one for one in ranges if one.name in controlled | fed)
        for letter, box in (("d", plant.disturbance), ("v", plant.noise)):
            ends = zip(box.lower, box.upper, strict=True) if box is not None else ()
            ranges += [_range(f"{letter}.{i}", *pair) for i, pair in enumerate(ends)]
        return Signals(
            continuous, noise, tuple(draws), tuple(one for one in ranges if one not in kept), kept, held,
            _columns(plant.disturbance) if held else None, plant.intensity if held else None,
        )  # fmt: skip

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


def _declared_noise(plant: Plant) -> dict[str, Expression]:
    """v_k uniform in its box, or L times standard normal numbers `draw.0`, .., L L' = R."""
    if plant.noise is not None:
        ends = zip(plant.noise.lower, plant.noise.upper, strict=True)
        boxes = (call("uniform", low.expression, high.expression) for low, high in ends)
        return {f"v.{k}": one for k, one in enumerate(boxes)}
    if plant.covariance is None:
        return {}
    L = factor(plant.covariance)
    rows = (
        sum((Number(Fraction(float(size))) * Variable(f"draw.{j}") for j, size in enumerate(row) if size), ZERO)
        for row in L
    )
    return {f"v.{k}": row for k, row in enumerate(rows)}


def factor(M: ExactMatrix) -> Array:
    """L with L L' = M >= 0, lower triangular, shape (n, n): a column is 0 where nothing is left of its variance.

    Raises: OverflowError: entries that floats do not hold.
    """
    values = M.floats
    if not np.all(np.isfinite(values)):
        raise OverflowError("a covariance beyond 1e308")
    L = np.zeros_like(values)
    for k in range(len(values)):
        left = values[k, k] - L[k] @ L[k]
        # Below rounding of its own variance an entry is a combination of those before it.
        if left > 1e-13 * values[k, k]:
            L[k:, k] = (values[k:, k] - L[k:] @ L[k]) / np.sqrt(left)
    return L


def _columns(box: Box | None) -> tuple[Array, Array] | None:
    """Both ends of a box, shape (n, 1)."""
    if box is None:
        return None
    lower, upper = (np.array([[float(end)] for end in ends]) for ends in (box.lower, box.upper))
    return lower, upper


def fed_back(signals: Mapping[str, Expression], inputs: Iterable[str]) -> set[str]:
    """The inputs whose signal reads the estimate or the last measurement."""
    return {name for name in inputs if signals[name].variables - {"t"}}


class Draws:
    """Random numbers by (run, purpose), as many as each run has asked for so far; the first run has number `first`."""

    def __init__(self, seed: int, runs: int, first: int = 0) -> None:
        self.seed, self.runs, self.first = seed, runs, first
        self._streams: dict[tuple[str, int], list[np.random.Generator]] = {}
        self._tables: dict[tuple[str, int], Array] = {}

    def at(self, purpose: str, kind: str, channel: int, runs: Integers, index: int | Integers) -> Array:
        """The number `index` of each given run (one for all, or one for each): uniform on [0, 1) or standard normal,
        shape (len(runs),)."""
        key = (purpose, channel)
        if key not in self._streams:
            keys = [(self.first + run, _PURPOSES[purpose], channel) for run in range(self.runs)]
            seeds = [np.random.SeedSequence(self.seed, spawn_key=key) for key in keys]
            self._streams[purpose, channel] = [np.random.default_rng(seed) for seed in seeds]
            self._tables[key] = np.empty((self.runs, 0))
        last = int(np.max(index))
        while last >= self._tables[key].shape[1]:
            count = max(8, self._tables[key].shape[1])
            draw = np.random.Generator.random if kind == "uniform" else np.random.Generator.standard_normal
            block = np.array([draw(stream, count) for stream in self._streams[key]])
            self._tables[key] = np.concatenate([self._tables[key], block], axis=1)
        numbers: Array = self._tables[key][runs, index]
        return numbers

    def table(self, purpose: str, kinds: Sequence[str], count: int) -> Array:
        """The first numbers of all runs, shape (R, channels, count); a channel without a kind is 0."""
        table = np.zeros((self.runs, len(kinds), count))
        for channel, kind in enumerate(kinds):
            if kind:
                self.at(purpose, kind, channel, np.arange(self.runs), count - 1)
                table[:, channel] = self._tables[purpose, channel][:, :count]
        return table


class Noise:
    """v_k at samples."""

    def __init__(self, signals: Signals, draws: Draws) -> None:
        self.signals, self.draws = signals, draws
        names = ["t", *(f"draw.{k}" for k in range(len(signals.draws)))]
        self._values = compile_floats(list(signals.noise.values()), names, arrays=True)

    def at(self, runs: Integers, index: int | Integers, t: Array) -> Array:
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
