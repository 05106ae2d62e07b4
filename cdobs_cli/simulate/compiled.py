"""The closed loop in machine code: generated routines and `engine.c`, the rules of the array path written once more.

What comes out is read by the same record, watch and summary. Randomness is that of the array path: its tables are
drawn here and read there. Where a signal leaves its declared interval the array path is asked, which says so.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from cdobs_cli.arrays import Array, Integers
from cdobs_cli.codegen import c_function, number, prelude
from cdobs_cli.exact.expression import Expression
from cdobs_cli.library import library
from cdobs_cli.records import dataclass
from cdobs_cli.simulate import dormand_prince as method
from cdobs_cli.simulate import trigger
from cdobs_cli.simulate.departure import Limits
from cdobs_cli.simulate.disturbance import PARTS, ROUNDING, Disturbance
from cdobs_cli.simulate.loop import ClosedLoop, Routine
from cdobs_cli.simulate.record import BEFORE, ON_GRID, Log, Samples
from cdobs_cli.simulate.signals import Draws

_STATE = "double t, const double *y, const double *held"
_ALL, _FULL, _DRAWS_WANTED, _OUTSIDE = range(4)
_GUESS = 256  # samples of a run that chooses them
_ROOM = 8_000_000  # numbers kept by one call


@dataclass(frozen=True)
class Layout:
    """Where the rows of `look` stand: all estimates, stops, signals that may end a run, signals that must stay, limits
    of the domain."""

    loop: ClosedLoop
    limits: Limits

    @property
    def kept_signals(self) -> list[Expression]:
        return [self.loop.visible[one.name] for one in self.loop.signals.held_ranges]

    @property
    def ranges(self) -> list[Any]:
        """Declared intervals of what is seen of signals."""
        return [one for one in self.loop.signals.ranges if one.name in self.loop.visible]

    @property
    def limit_rows(self) -> list[Expression]:
        """The values of the limits: of the states, then of the estimate where one is reported."""
        reported = self.loop.observer.estimates.get("x_hat")
        at_x, at_x_hat = self.limits.groups
        rows = [one.value for one in at_x]
        if reported is not None:
            there = dict(zip(self.loop.plant.states, reported, strict=True))
            rows += [one.value.substitute(there) for one in at_x_hat]
        return rows

    def rows(self) -> dict[str, list[Expression]]:
        loop = self.loop
        estimates = {f"estimate {name}": list(rows) for name, rows in loop.observer.estimates.items()}
        return estimates | {
            "STOP": [expression for expression, _ in loop.observer.stops],
            "KEEP": self.kept_signals,
            "RANGE": [loop.visible[one.name] for one in self.ranges],
            "LIMIT": self.limit_rows,
        }

    def places(self) -> dict[str, int]:
        places, at = {}, 0
        for name, rows in self.rows().items():
            places[name] = at
            at += len(rows)
        return places | {"SEEN": at}


def source(loop: ClosedLoop, limits: Limits) -> str:
    """The whole C file of a loop."""
    layout = Layout(loop, limits)
    reads = {"t": "t"} | {name: f"y[{i}]" for i, name in enumerate(loop.system.states)}
    reads |= {name: f"held[{i}]" for i, name in enumerate(loop.held)}

    def written(name: str, routine: Routine, argument: str = "") -> str:
        further = {one: f"{argument}[{k}]" for k, one in enumerate(routine.further)}
        extra = f", const double *{argument}" if argument else ""
        return c_function(name, _STATE + extra, routine.rows, reads | further)

    routines, look = loop.routines, [loop.closed(row) for rows in layout.rows().values() for row in rows]
    noise, draws = (
        tuple(loop.signals.noise.values()),
        {f"draw.{k}": f"draw[{k}]" for k in range(len(loop.signals.draws))},
    )
    engine = Path(__file__).with_name("engine.c").read_text(encoding="ascii")
    code = "\n".join([
        *(f"#define {name} {value}" for name, value in _sizes(layout).items()), "",
        written("flow", routines["flow"]), written("measure", routines["measure"], "v"),
        *(written(f"jump_{q}", jump, "m") for q, jump in enumerate(loop.jumps)), _jump(len(loop.jumps)),
        written("control", routines["control"]),
        written("trigger", routines["trigger"]), c_function("look", _STATE, look, reads),
        c_function("noise_of", "double t, const double *draw", noise, {"t": "t"} | draws),
        _step(), _dense(), engine,
    ])  # fmt: skip
    return prelude(code) + code


def _sizes(layout: Layout) -> dict[str, Any]:
    loop, places, rows = layout.loop, layout.places(), layout.rows()
    estimates = loop.observer.estimates
    encloses = "x_lower" in estimates and "x_upper" in estimates
    return {
        "SIZE": loop.size, "STATES": loop.plant.n, "HELD": len(loop.held), "OUTPUTS": loop.plant.p,
        "CONTROLS": len(loop.controls), "LAST_MEASURED": len(loop.last_measured), "DISTURBED": len(loop.signals.held),
        "DRAWS": len(loop.signals.draws), "NOISES": len(loop.signals.noise),
        "ESTIMATE": 1 if "x_hat" in estimates else 2 if encloses else 0, "ENCLOSES": int(encloses),
        "X_HAT": places.get("estimate x_hat", 0), "X_LOWER": places.get("estimate x_lower", 0),
        "X_UPPER": places.get("estimate x_upper", 0),
        "STOP": places["STOP"], "STOPS": len(rows["STOP"]), "KEEP": places["KEEP"], "KEPT": len(rows["KEEP"]),
        "RANGE": places["RANGE"], "RANGES": len(rows["RANGE"]), "LIMIT": places["LIMIT"], "LIMITS": len(rows["LIMIT"]),
        "SEEN": places["SEEN"], "RTOL": number(method.RTOL),
        "ROOT_FINE": number(trigger.FINE), "ROOT_ITERATIONS": trigger.ITERATIONS,
        "AT_AN_END": number(method.AT_AN_END), "ROOT_FAR": number(trigger.FAR), "ROOT_NEAR": number(trigger.NEAR),
    }  # fmt: skip


def _jump(readings: int) -> str:
    """The jump after each reading."""
    lines = [
        "static void jump(long reading, double t, const double *y, const double *held, const double *m, double *out)"
    ]
    lines += ["{", "    switch (reading) {"]
    lines += [f"    case {q}: jump_{q}(t, y, held, m, out); break;" for q in range(readings)]
    return "\n".join([*lines, "    }", "}", ""])


def _sum(weights: Sequence[float]) -> str:
    return " + ".join(f"{number(weight)} * k[{j}][i]" for j, weight in enumerate(weights) if weight)


def _stage(place: str, time: float, weights: Sequence[float]) -> list[str]:
    when = "t + h" if time == 1.0 else f"t + {number(time)} * h"
    lines = ["    for (int i = 0; i < SIZE; i++)", f"        z[i] = y[i] + h * ({_sum(weights)});"]
    return [*lines, f"    flow({when}, z, held, {place});"]


def _step() -> str:
    """One step: k[0] is the slope at its start; fills the others, the new state and the weighted error."""
    lines = [
        "static void step(double t, double h, const double *y, const double *held, const double *low,",
        "                 double k[13][SIZE], double *z, double *error)", "{",
    ]  # fmt: skip
    for s in range(1, 13):
        lines += _stage(f"k[{s}]", 1.0 if s == 12 else method.C[s], method.A[s])
    lines += [
        "    double five = 0.0, three = 0.0;",
        "    for (int i = 0; i < SIZE; i++) {",
        "        double scale = low[i] + RTOL * max(fabs(y[i]), fabs(z[i])), part;",
        f"        part = ({_sum(method.E5)}) / scale;", "        five += part * part;",
        f"        part = ({_sum(method.E3)}) / scale;", "        three += part * part;", "    }",
        "    *error = five == 0.0 ? 0.0 : h * five / sqrt((five + 0.01 * three) * SIZE);", "}", "",
    ]  # fmt: skip
    return "\n".join(lines)


def _dense() -> str:
    """The seven coefficients of dense output over a step from y to `end`."""
    lines = [
        "static void dense(double t, double h, const double *y, const double *held, double slopes[13][SIZE],",
        "                  const double *end, double c[7][SIZE])", "{",
        "    double k[16][SIZE], z[SIZE];", "    memcpy(k, slopes, 13 * sizeof k[0]);",
    ]  # fmt: skip
    for extra, (c, row) in enumerate(zip(method.C_EXTRA, method.A_EXTRA, strict=True)):
        lines += _stage(f"k[{13 + extra}]", c, row)
    lines += [
        "    for (int i = 0; i < SIZE; i++) {", "        double change = end[i] - y[i];", "        c[0][i] = change;",
        "        c[1][i] = h * k[0][i] - change;", "        c[2][i] = 2 * change - h * (k[12][i] + k[0][i]);",
        *(f"        c[{3 + row}][i] = h * ({_sum(weights)});" for row, weights in enumerate(method.D)),
        "    }", "}", "",
    ]  # fmt: skip
    return "\n".join(lines)


class _Batch(ctypes.Structure):
    """As in engine.c."""

    _fields_ = (
        [(name, ctypes.c_double) for name in ("horizon", "atol", "smallest_share", "longest", "step_slack")]
        + [(name, ctypes.c_long) for name in (
            "runs", "max_steps", "max_samples", "grid_points", "drawn_noise", "drawn_disturbance", "bounded", "white",
            "chooses")]
        + [(name, ctypes.c_void_p) for name in (
            "grid", "low", "high", "factor", "ends", "y0", "held0", "before0", "measured0", "limit", "instants",
            "noise", "disturbance")]
        + [("unread", ctypes.c_void_p), ("readings", ctypes.c_void_p), ("patterns", ctypes.c_long)]
        + [("instants_each", ctypes.c_long), ("log", ctypes.c_void_p), ("samples", ctypes.c_void_p)]
        + [(name, ctypes.c_long) for name in ("log_rows", "sample_rows")]
        + [(name, ctypes.c_void_p) for name in (
            "log_from", "samples_from", "code", "steps", "which", "stop_t", "stop_y", "stop_held", "margin", "first",
            "value", "beyond")]
    )  # fmt: skip


class Compiled:
    """The library of a loop."""

    def __init__(self, loaded: ctypes.CDLL, path: Path, layout: Layout) -> None:
        self.path, self.layout = path, layout
        self._run = loaded.run_batch
        self._run.argtypes = [ctypes.POINTER(_Batch), ctypes.c_long, ctypes.POINTER(ctypes.c_long)]

    @staticmethod
    def of(loop: ClosedLoop) -> Compiled | None:
        """None where there is no compiler, or it does not take the loop."""
        limits = Limits(loop.system)
        made = library(source(loop, limits))
        return None if made is None else Compiled(*made, Layout(loop, limits))

    @property
    def is_checked(self) -> bool:
        """Whether it was found to do as the array path does."""
        return self.path.with_suffix(".checked").exists()

    def mark_checked(self) -> None:
        """So that the next process need not look. Where the mark cannot be set, it does."""
        with suppress(OSError):
            self.path.with_suffix(".checked").touch(mode=0o600)

    def run(self, numbers: Mapping[str, Any], disturbance: Disturbance, draws: Draws) -> Made | None:
        """All runs to their ends; None where a signal leaves its declared interval.

        Args:
            numbers: what engine.c needs, by its names: `grid` (G,), `code`, `limit` (R,), `y0` (n, R), `held0` (c, R),
                `before0` (n + c, R), `measured0` (p, R), `instants` (R, K) or None, `unread` (readings, p),
                `readings` (R, K), and the limits of work.
        """
        fields = dict(numbers) | self._constants(disturbance)
        instants = fields.pop("instants")
        chooses = instants is None
        fields |= {name: np.ascontiguousarray(fields[name].T) for name in ("y0", "held0", "before0", "measured0")}
        fields |= {"chooses": int(chooses), "grid_points": len(fields["grid"])}
        fields |= {
            "instants": np.zeros(1) if chooses else instants,
            "instants_each": 0 if chooses else instants.shape[1],
        }
        fields |= {"patterns": len(fields["unread"])}
        outcome = Outcome.empty(fields["runs"], self.layout.loop, len(self.layout.rows()["LIMIT"]))
        outcome.code[:] = fields.pop("code")
        samples = _GUESS if chooses else instants.shape[1] + 1
        pieces = self._call(fields, outcome, samples, lambda count: self._random(draws, disturbance, count))
        return None if pieces is None else (outcome, *pieces.joined(fields["runs"], self.layout.loop))

    def _call(
        self, fields: dict[str, Any], outcome: Outcome, samples: int, random: Callable[[int], dict[str, Any]]
    ) -> Pieces | None:
        """Run after run; where the room or the random numbers run out there is more, and it goes on."""
        runs, loop, pieces = fields["runs"], self.layout.loop, Pieces(self.layout.loop)
        each = fields["grid_points"] + 2 * samples + 2
        together = max(1, min(runs, _ROOM // (each * pieces.width)))
        rows, sampled, count = together * each, together * samples, samples + 1
        drawn, first, done = random(count), 0, ctypes.c_long(0)
        while first >= 0:
            log, at_samples = np.empty((pieces.width, rows)), np.empty((1 + loop.plant.p, sampled))
            offsets = np.zeros(runs + 1, dtype=np.int64), np.zeros(runs + 1, dtype=np.int64)
            given = fields | drawn | dict(vars(outcome)) | {
                "log": log, "samples": at_samples, "log_rows": rows, "sample_rows": sampled,
                "log_from": offsets[0], "samples_from": offsets[1],
            }  # fmt: skip
            ended = self._run(ctypes.byref(_filled(given)), first, ctypes.byref(done))
            if ended == _OUTSIDE:
                return None
            last = runs if ended == _ALL else done.value
            pieces.add(first, last, log, at_samples, *offsets)
            if ended == _FULL and last == first:
                rows, sampled = 2 * rows, 2 * sampled
            if ended == _DRAWS_WANTED:
                count *= 2
                drawn = random(count)
            first = done.value
        return pieces

    def _constants(self, disturbance: Disturbance) -> dict[str, Any]:
        layout, signals = self.layout, self.layout.loop.signals
        by_name, free = {one.name: one.ends for one in signals.ranges}, (-np.inf, np.inf)
        ends = [one.ends for one in (*layout.ranges, *signals.held_ranges)]
        ends += [by_name.get(name, free) for name in signals.noise]
        limits = [(one.lower, one.upper, one.slack) for one in layout.limits.limits]
        factor = np.zeros(1) if disturbance.white is None else disturbance.white
        if disturbance.box is not None:
            factor = np.concatenate(disturbance.box, axis=1)
        return {
            "atol": method.ATOL, "smallest_share": method.SMALLEST_SHARE, "longest": disturbance.longest,
            "step_slack": ROUNDING, "bounded": int(disturbance.box is not None),
            "white": int(disturbance.white is not None), "factor": np.ascontiguousarray(factor, dtype=float),
            "low": np.array([low for low, _ in ends] + [0.0]), "high": np.array([high for _, high in ends] + [0.0]),
            "ends": np.array([*limits, (0.0, 0.0, 0.0)]),
        }  # fmt: skip

    def _random(self, draws: Draws, disturbance: Disturbance, count: int) -> dict[str, Any]:
        """The tables of random numbers, for so many samples."""
        kinds, parts = ["uniform"] * len(self.layout.loop.signals.held), 1
        if disturbance.white is not None:
            kinds = ["normal" if any(column) else "" for column in disturbance.white.T]
            parts = PARTS
        return {
            "noise": draws.table("noise", self.layout.loop.signals.draws, count), "drawn_noise": count,
            "disturbance": draws.table("disturbance", kinds, parts * count), "drawn_disturbance": parts * count,
        }  # fmt: skip


def _filled(values: dict[str, Any]) -> _Batch:
    """The structure; arrays must outlive the call, which `values` sees to."""
    batch = _Batch()
    for name, value in values.items():
        setattr(batch, name, value.ctypes.data if isinstance(value, np.ndarray) else value)
    return batch


@dataclass(frozen=True)
class Outcome:
    """What is known of every run in the end; `beyond` (limits, R), the rest by run."""

    code: Integers
    steps: Integers
    which: Integers
    stop_t: Array
    stop_y: Array
    stop_held: Array
    margin: Array
    first: Array
    value: Array
    beyond: Array

    @staticmethod
    def empty(runs: int, loop: ClosedLoop, limits: int) -> Outcome:
        code, steps, which = (np.zeros(runs, dtype=np.int64) for _ in range(3))
        stop_t, margin, first, value = (np.zeros(runs) for _ in range(4))
        stop_y, stop_held = np.zeros((runs, loop.size)), np.zeros((runs, len(loop.held)))
        return Outcome(code, steps, which, stop_t, stop_y, stop_held, margin, first, value, np.zeros((limits, runs)))


class Pieces:
    """Logs (2 + n + c, P) and samples (1 + p, K) of one call after the other: time, kind, numbers; time, measured."""

    def __init__(self, loop: ClosedLoop) -> None:
        self.width = 2 + loop.size + len(loop.held)
        self.run, self.rows = list[Integers](), list[Array]()
        self.sampled_run, self.sampled = list[Integers](), list[Array]()

    def add(
        self, first: int, last: int, log: Array, samples: Array, log_from: Integers, samples_from: Integers
    ) -> None:
        """Runs first .. last - 1, whose rows end at the places that follow theirs."""
        whose = np.arange(first, last)
        for at, rows, ids, kept in ((log_from, log, self.run, self.rows),
                                    (samples_from, samples, self.sampled_run, self.sampled)):  # fmt: skip
            ends = at[first : last + 1].copy()
            ends[0] = 0
            ids.append(np.repeat(whose, np.diff(ends)))
            kept.append(rows[:, : ends[-1]])

    def joined(self, runs: int, loop: ClosedLoop) -> tuple[Log, Samples]:
        """As the array path records it."""
        rows, whose = _side_by_side(self.rows), np.concatenate(self.run)
        kind = rows[1].astype(np.int64)
        jumps = np.cumsum(kind == BEFORE)
        begins = np.searchsorted(whose, np.arange(runs))
        index = np.where(kind == ON_GRID, 0, jumps - jumps[begins][whose])
        sampled, at = _side_by_side(self.sampled), np.concatenate(self.sampled_run)
        samples = Samples(np.searchsorted(at, np.arange(runs + 1)), sampled[0], sampled[1:])
        return Log(whose, kind, index, rows[0], rows[2:]), samples


def _side_by_side(pieces: list[Array]) -> Array:
    return pieces[0] if len(pieces) == 1 else np.concatenate(pieces, axis=1)


Made = tuple[Outcome, Log, Samples]
