"""A box of x(0) and a word of sampling periods after which a bound crosses the state, proved in balls.

    e(0) = [S^+ S^-; S^- S^+] (x - x_lower, x_upper - x),    e(t_k + s) = exp(M s) e_k + Gamma(s) (N1 e_k + b_k)
    (x - x_lower, x_upper - x) = [R^+ R^-; R^- R^+] e,        R = S^-1

with the disturbance constant between two samples and the noise as it is read at one. What floats propose, the ball
of that one component decides; what is stored is rational (periods as typed in the law) and can be run again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flint import arb

from cdobs_cli.certificate import Witness
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import Exact, ExactMatrix, fraction_text, upper_text
from cdobs_cli.families.interval.analysis import at_most
from cdobs_cli.families.interval.cone import both_sides
from cdobs_cli.families.interval.intersect import measured_rows
from cdobs_cli.families.interval.theorems import Coordinates, coordinates, error_flow, error_held
from cdobs_cli.plant import Box, Plant
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
        """Whether the law certainly allows these periods, and a last one as long as `after`."""
        periods = all(at_most(law.T_min, T) and at_most(T, law.T_max) for T in self.periods)
        return periods and all(T.sign() == 1 for T in (*self.periods, self.after)) and at_most(self.after, law.T_max)

    def is_inside(self) -> bool:
        """Whether x(0) is in its box."""
        return all(low <= x <= high for low, x, high in zip(self.lower, self.state, self.upper, strict=True))

    def witness(self, plant: Plant, distance: arb) -> Witness:
        """As stored: decimal or rational strings, one row of `disturbance` and `noise` a sample."""
        n = plant.n
        bound = f"{'lower' if self.component < n else 'upper'} bound of {plant.states[self.component % n]}"
        data: dict[str, Any] = {
            "lower": [fraction_text(value) for value in self.lower], "upper": [fraction_text(value) for value in self.upper],
            "state": [fraction_text(value) for value in self.state], "after": str(self.after), "bound": bound,
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


def distance(plant: Plant, gain: Mapping[str, ExactMatrix], crossing: Crossing, *, cut: bool) -> arb:
    """The distance of x from the bound at the end of the run, enclosed: negative where the bound has crossed it.

    Args:
        cut: whether measured rows of z are intersected with y at samples.
    """
    S = gain["S"].balls()
    z = coordinates(plant.A.balls(), plant.C.balls(), S, S.inverse(), gain["L"].balls())
    rows = measured_rows(plant.C.balls(), S) if cut else {}
    box = [x - low for low, x in zip(crossing.lower, crossing.state, strict=True)]
    box += [high - x for high, x in zip(crossing.upper, crossing.state, strict=True)]
    e = both_sides(z.S) @ Matrix.from_rows([[value] for value in box])
    for length, low_d, low_v in zip((*crossing.periods, crossing.after), crossing.low_d, crossing.low_v, strict=True):
        above_d, above_v = _distances(plant.disturbance, low_d, plant.n), _distances(plant.noise, low_v, plant.p)
        # Noise enters z' as S L v, so its upper end is the distance of z_lower: the two ends are swapped.
        b = both_sides(z.S) @ above_d + both_sides(z.SL) @ _swapped(above_v)
        e = _advance(z, _cut(e, rows, above_v), b, length.ball())
    return arb((both_sides(z.R) @ e)[crossing.component, 0])


def _distances(box: Box | None, low: tuple[bool, ...], size: int) -> Matrix:
    """(v - v_lower, v_upper - v) for v at the chosen ends, shape (2 size, 1)."""
    if box is None:
        return Matrix.zeros(2 * size, 1)
    widths = [high - low for low, high in zip(box.lower, box.upper, strict=True)]
    zero = Exact(0)
    from_low = [zero if is_low else width for width, is_low in zip(widths, low, strict=True)]
    from_high = [width if is_low else zero for width, is_low in zip(widths, low, strict=True)]
    return ExactMatrix([[value] for value in (*from_low, *from_high)]).balls()


def _swapped(v: Matrix) -> Matrix:
    half = v.shape[0] // 2
    swapped: Matrix = block([[v[half:, :]], [v[:half, :]]])
    return swapped


def _cut(e: Matrix, rows: Mapping[int, Matrix], above_v: Matrix) -> Matrix:
    """e after measured rows of z were intersected with what y leaves: z_i - (G y - ..) at most."""
    n = e.shape[0] // 2
    values = [arb(e[i, 0]) for i in range(2 * n)]
    for i, G in rows.items():
        left = both_sides(G) @ _swapped(above_v)
        values[i] = arb.min(values[i], arb(left[0, 0]))
        values[n + i] = arb.min(values[n + i], arb(left[1, 0]))
    return Matrix.from_rows([[value] for value in values])


def _advance(z: Coordinates[Matrix], e: Matrix, b: Matrix, s: arb) -> Matrix:
    """exp(M s) e + Gamma(s) (N1 e + b)."""
    M, size = error_flow(z.Q0), e.shape[0]
    flow = block([[M, error_held(z.Q1) @ e + b], [Matrix.zeros(1, size), Matrix.zeros(1, 1)]]).exp(s)
    after: Matrix = (flow @ block([[e], [Matrix.identity(1)]]))[0:size, :]
    return after


def refutes(plant: Plant, gain: Mapping[str, ExactMatrix], crossing: Crossing, law: SamplingLaw, *, cut: bool) -> Witness | None:
    """The witness, where the crossing is proved and of the law."""
    if not crossing.is_of(law) or not crossing.is_inside():
        return None
    found = distance(plant, gain, crossing, cut=cut)
    return crossing.witness(plant, found) if found < 0 else None
