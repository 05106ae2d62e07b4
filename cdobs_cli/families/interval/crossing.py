"""A box of x(0) and a word of sampling periods after which a bound crosses the state, proved in balls.

    e(0) = [S^+ S^-; S^- S^+] (x - x_lower, x_upper - x),    e(t_k + s) = exp(M s) e_k + Gamma(s) (N1 e_k + b_k)
    (x - x_lower, x_upper - x) = [R^+ R^-; R^- R^+] e,        R = S^-1

with the disturbance constant between two samples and the noise as it is read at one. What floats propose, the ball
of that one component decides; what is stored is rational (periods as typed in the law) and can be run again.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from flint import arb

from cdobs_cli.certificate import Witness
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import Exact, fraction_text, upper_text
from cdobs_cli.families.interval.parts import both_sides, column, entries
from cdobs_cli.families.interval.system import System
from cdobs_cli.plant import Box, Plant
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw


@dataclass(frozen=True)
class Crossing:
    """A run that loses the state.

    lower, upper, state: the box of x(0) and x(0) in it. periods: T_0, T_1, .. between the samples before the crossing;
    after: how long after the last of them it comes. low_d, low_v: for each sample, whether each disturbance is at its
    lower end until the next and each noise at its lower end at that sample (else at the upper).
    component: which of (x - x_lower, x_upper - x) is negative, counted from 0.
    """

    lower: tuple[Fraction, ...]
    upper: tuple[Fraction, ...]
    state: tuple[Fraction, ...]
    periods: tuple[Exact, ...]
    after: Exact
    low_d: tuple[tuple[bool, ...], ...]
    low_v: tuple[tuple[bool, ...], ...]
    component: int

    def is_of(self, law: SamplingLaw) -> bool:
        """Whether x(0) is in its box, and the law certainly allows these periods and a last one as long as `after`."""
        inside = all(low <= x <= high for low, x, high in zip(self.lower, self.state, self.upper, strict=True))
        periods = all(law.T_min.is_at_most(T) and T.is_at_most(law.T_max) for T in self.periods)
        positive = all(T.sign() == 1 for T in (*self.periods, self.after))
        return inside and periods and positive and self.after.is_at_most(law.T_max)

    def witness(self, plant: Plant, distance: arb) -> Witness:
        """As stored: decimal or rational strings, one row of `disturbance` and `noise` a sample."""
        side = "lower" if self.component < plant.n else "upper"
        box = {"lower": self.lower, "upper": self.upper, "state": self.state}
        data: dict[str, Any] = {name: [fraction_text(value) for value in values] for name, values in box.items()} | {
            "after": str(self.after), "bound": f"{side} bound of {plant.states[self.component % plant.n]}",
            "component": self.component, "distance": upper_text(distance),
            "disturbance": [list(map(str, chosen(plant.disturbance, low))) for low in self.low_d],
            "noise": [list(map(str, chosen(plant.noise, low))) for low in self.low_v],
        }  # fmt: skip
        return Witness("box", "plant", tuple(map(str, self.periods)), data=data)


def chosen(box: Box | None, low: tuple[bool, ...]) -> tuple[Exact, ...]:
    """The ends of a declared box that were chosen; empty without one."""
    if box is None:
        return ()
    return tuple(a if is_low else b for a, b, is_low in zip(box.lower, box.upper, low, strict=True))


def distance(system: System, crossing: Crossing) -> arb:
    """The distance of x from the bound at the end of the run, enclosed: negative where the bound has crossed it."""
    z, errors = system.z, system.errors
    below = [x - low for low, x in zip(crossing.lower, crossing.state, strict=True)]
    above = [high - x for high, x in zip(crossing.upper, crossing.state, strict=True)]
    e = errors.start @ column([*below, *above])
    disturbance, noise = system.widths
    for length, low_d, low_v in zip((*crossing.periods, crossing.after), crossing.low_d, crossing.low_v, strict=True):
        # Noise enters z' as S L v, so its upper end is the distance of z_lower: its two ends are swapped.
        below_v = _distances(noise, low_v, swapped=True)
        b = errors.start @ _distances(disturbance, low_d, swapped=False) + both_sides(z.SL) @ below_v
        e = errors.after(_cut(e, system.cut_rows, below_v), b, length.ball())
    return arb((both_sides(z.R) @ e)[crossing.component, 0])


def _distances(width: Matrix, low: tuple[bool, ...], *, swapped: bool) -> Matrix:
    """(v - v_lower, v_upper - v) for v at the chosen ends, shape (2 size, 1); swapped: the other way round."""
    ends = list(zip((row[0] for row in width.tolist()), low, strict=True))
    from_low = column(value * (not is_low) for value, is_low in ends)
    from_high = column(value * is_low for value, is_low in ends)
    return block([[from_high], [from_low]] if swapped else [[from_low], [from_high]])


def _cut(e: Matrix, rows: Mapping[int, Matrix], below_v: Matrix) -> Matrix:
    """e after measured rows of z were intersected with what y leaves: z_i - (G y - ..) at most."""
    n, values = e.shape[0] // 2, entries(e)
    for i, G in rows.items():
        left = entries(both_sides(G) @ below_v)
        values[i], values[n + i] = arb.min(values[i], left[0]), arb.min(values[n + i], left[1])
    return column(values)


def refutes(system: System, crossing: Crossing, law: SamplingLaw) -> Witness | None:
    """The witness, where the crossing is proved and of the law."""
    reached = distance(system, crossing) if crossing.is_of(law) else arb(0)
    return crossing.witness(system.plant, reached) if reached < 0 else None
