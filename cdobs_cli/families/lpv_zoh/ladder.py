"""What each method proves for one gain: at a law and rate, at its longest period, at its fastest rate."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import clock
from cdobs_cli.certify.falsify import refute
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh import any_gain, printed_search, repaired, wirtinger
from cdobs_cli.families.lpv_zoh.claims import slowest_constant_slope
from cdobs_cli.families.lpv_zoh.laws import at_period, largest, short
from cdobs_cli.families.lpv_zoh.observer import inclusion
from cdobs_cli.families.lpv_zoh.structure import is_class_16
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold

_TOLERANCE = (Fraction(1, 100), Fraction(1, 500), Fraction(1, 2000), Fraction(1, 10000))
_FINE = Fraction(1, 20000)
_SCAN = 24
# Sizes up to which a clock certificate gets one step more of the schedule for the headline, the whole schedule,
# or (by effort) a search at all.
_HEADLINE, _WHOLE = 700, 2_000
_LARGEST = (15_000, 15_000, 70_000, 200_000)


def methods(family: LpvZeroOrderHold, plant: Plant) -> tuple[str, ...]:
    """The certificates to look for. The printed Theorem 1 is none: its proof has a gap."""
    if family.method in ("clock", "wirtinger", "repaired"):
        return (family.method,)
    return ("wirtinger", "clock", "repaired") if is_class_16(plant) else ("wirtinger", "clock")


def floor_rate(T: float, share: float) -> Fraction:
    """The rate asked for at a period: this share of 1 / T, in six digits."""
    return Fraction(str(short(share / T).rational)) if share else Fraction(0)


def prove_by(method: str, plant: Plant, L: ExactMatrix, effort: int, sigma: Fraction) -> Certificate | None:
    """One method's proof for this gain under the plant's law, at a rate."""
    T = plant.sampling.T_max
    if method == "wirtinger":
        return wirtinger.analyse(plant, L, T, sigma)
    if method == "repaired":
        return repaired.analyse(plant, L, T, sigma)
    if method == "theorem_1":
        return printed_search.search(plant, L, T)
    return _clock(plant, L, effort, sigma)


def _clock(plant: Plant, L: ExactMatrix, effort: int, sigma: Fraction) -> Certificate | None:
    """The clock certificate, asked for only where no counterexample stands against it: a search that fails is
    the dearest."""
    system = inclusion(plant, {"L": L})
    if not clock_is_tried(plant, effort) or refute(system, 0) is not None:
        return None
    limit = slowest_constant_slope(plant, L) if sigma else None
    if limit is not None and Exact(sigma).ball() >= limit:
        return None
    return clock.analyse(system, effort if size(plant) <= _WHOLE else 0, sigma)


def clock_is_tried(plant: Plant, effort: int) -> bool:
    """Whether the plant is small enough for clock certificates at this effort."""
    return size(plant) <= _LARGEST[max(0, min(effort, 3))]


def headline(plant: Plant, effort: int) -> int:
    """The headline is worth one step more of the schedule than the search for a gain, where that is cheap."""
    return min(effort + 1, 3) if size(plant) <= _HEADLINE else effort


def size(plant: Plant) -> int:
    """What a clock certificate costs, roughly: (n + p)^3 times the corners."""
    return int((plant.n + plant.p) ** 3 * 2 ** len(plant.slopes.uncertain))


def largest_by(method: str, plant: Plant, L: ExactMatrix, effort: int, floor: float) -> tuple[Exact, Certificate] | None:
    """The largest period one method proves for this gain."""
    start = plant.sampling.T_max

    def prove(T: Exact) -> Certificate | None:
        return prove_by(method, at_period(plant, T), L, effort, floor_rate(float(T), floor))

    # A clock proof costs much more than the others: its search stops earlier.
    tolerance = _TOLERANCE[max(0, min(effort, 3))] if method == "clock" else _FINE
    return largest(prove, start, tolerance)


def certificates(family: LpvZeroOrderHold, plant: Plant, L: ExactMatrix, effort: int) -> tuple[Certificate, ...]:
    """For each method a proof at the largest period it reaches, and one at the law designed for with the
    largest rate; for the printed theorem the (P, Y) that take it furthest."""
    made: list[Certificate] = []
    for method in methods(family, plant):
        level = headline(plant, effort) if method == "clock" else effort
        longest = largest_by(method, plant, L, level, 0.0)
        if longest is not None:
            made.append(longest[1])
        rate = _fastest_by(method, plant, L, level)
        made += [rate] if rate is not None else []
    if family.method == "theorem_1" and family.printed is None:
        printed = largest_by("theorem_1", plant, L, effort, 0.0)
        made += [printed[1]] if printed is not None else []
    return tuple(made)


def _fastest_by(method: str, plant: Plant, L: ExactMatrix, effort: int) -> Certificate | None:
    """The largest rate one method proves under the plant's own law."""

    def prove(sigma: Exact) -> Certificate | None:
        return prove_by(method, plant, L, effort, sigma.rational or Fraction(0))

    at_rest = prove(Exact(0))
    if at_rest is None or method == "repaired":  # its line search on alpha is after the rate already
        return at_rest
    found = largest(prove, short(0.5 / float(plant.sampling.T_max)), Fraction(1, 200))
    return at_rest if found is None else found[1]


def beyond_any_gain(plant: Plant, proved: float | None, effort: int) -> tuple[Certificate, ...]:
    """Periods that no gain survives: the law's own where nothing is proved, and the smallest found above what is."""

    def search(value: float) -> Certificate | None:
        return any_gain.search(plant, plant.sampling.with_period(short(value)), effort)

    made: list[Certificate] = []
    low = proved if proved is not None else float(plant.sampling.T_max) / 100
    high = low
    if proved is None:
        own = any_gain.search(plant, plant.sampling, effort)
        made += [own] if own is not None else []
        high = float(plant.sampling.T_max)
    found = made[0] if made else None
    for _ in range(_SCAN):
        if found is not None:
            break
        low, high = high, high * 1.15
        found = search(high)
    if found is None:
        return ()
    while high - low > 1e-5 * high:
        middle = (low + high) / 2
        nearer = search(middle)
        if nearer is None:
            low = middle
        else:
            high, found = middle, nearer
    return (*made, found) if found not in made else tuple(made)
