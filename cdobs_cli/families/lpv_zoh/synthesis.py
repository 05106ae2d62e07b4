"""The gain, and a certificate for each period and rate worth proving."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import clock
from cdobs_cli.certify.falsify import refute
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh import any_gain, printed_search, repaired, wirtinger
from cdobs_cli.families.lpv_zoh.claims import slowest_constant_slope
from cdobs_cli.families.lpv_zoh.climb import GAIN_DIGITS, Climb
from cdobs_cli.families.lpv_zoh.corners import MOST_CORNERS
from cdobs_cli.families.lpv_zoh.curve import gain_curve
from cdobs_cli.families.lpv_zoh.laws import at_period, largest, short
from cdobs_cli.families.lpv_zoh.observer import inclusion
from cdobs_cli.families.lpv_zoh.structure import is_class_16
from cdobs_cli.families.lpv_zoh.units import Units
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold

    Array = NDArray[np.float64]

# Under max_period the rate is at least this over the period: a design on the edge converges never.
RATE_FLOOR = 0.002
_TOLERANCE = (Fraction(1, 100), Fraction(1, 500), Fraction(1, 2000), Fraction(1, 10000))
_FINE = Fraction(1, 20000)
_SCAN = 24
# Sizes (see `_size`) up to which a clock certificate gets one step more of the schedule for the headline, the
# whole schedule, or a search at all.
_HEADLINE, _CLOCK_SMALL = 700, 2_000
_CLOCK_LARGEST = (7_000, 7_000, 70_000, 200_000)  # by effort


@dataclass(frozen=True)
class Found:
    """A gain as it is run, and the period for which it was found."""

    L: ExactMatrix
    T: Exact


class NoDesignError(Exception):
    """No gain was found; the message says how far the search went."""


def synthesize(family: LpvZeroOrderHold, plant: Plant, effort: int) -> Design:
    """The design: the given gain or one found for the objective, with its certificates."""
    corners = 2 ** len(plant.slopes.uncertain)
    if corners > MOST_CORNERS:
        reason = f"the slope box has {corners} corners, at most {MOST_CORNERS} are taken: declare fewer slopes that vary"
        return Design(family.family, "none", plant.sampling, {}, reason=reason)
    try:
        found = _given(family, plant, effort) if family.gain is not None else _search(family, plant, effort)
        if float(found.T) < float(plant.sampling.T_max):
            raise NoDesignError(f"the longest period found is {found.T}, below the least acceptable {plant.sampling.T_max}")
    except NoDesignError as none:
        certificates = _any_gain(plant, None, effort)
        return Design(family.family, "none", plant.sampling, {}, certificates, reason=str(none))
    law = plant.sampling.with_period(found.T)
    certificates = _certificates(family, at_period(plant, found.T), found.L, effort)
    proved = max((float(c.sampling.T_max) for c in certificates if c.method != printed_search.METHOD), default=None)
    # The curve of period against rate belongs to a search; effort 0 is for a quick answer.
    searched = family.gain is None and effort > 0
    details: dict[str, Any] = {"curve": gain_curve(plant, found.L, found.T, _headline(plant, effort))} if searched else {}
    return Design(
        family.family, "given" if family.gain is not None else "found", law, {"L": found.L},
        certificates + _any_gain(plant, proved, effort), details=details,
    )  # fmt: skip


# The gain.


def _given(family: LpvZeroOrderHold, plant: Plant, effort: int) -> Found:
    """The given gain; under max_period the largest period proved for it with the rate floor."""
    assert family.gain is not None
    L = family.gain.L
    T = plant.sampling.T_max
    if family.objective == "max_period":
        best = max(
            (float(found[0]) for method in _methods(family, plant) if (found := _largest(method, plant, L, effort, RATE_FLOOR))),
            default=0.0,
        )
        if best > float(T):
            T = short(best)
    return Found(L, T)


def _methods(family: LpvZeroOrderHold, plant: Plant) -> tuple[str, ...]:
    """The certificates to look for. The printed Theorem 1 is none: its proof has a gap."""
    if family.method in ("clock", "wirtinger", "repaired"):
        return (family.method,)
    return ("wirtinger", "clock", "repaired") if is_class_16(plant) else ("wirtinger", "clock")


def _search(family: LpvZeroOrderHold, plant: Plant, effort: int) -> Found:
    """A gain for the objective.

    Raises:
        NoDesignError: with how far the search went.
    """
    if family.method == "wirtinger":
        return _wirtinger_gain(plant, family.objective)
    if family.method in ("repaired", "theorem_1"):
        return _climb_period(family.method, plant, family.objective, effort)
    if family.objective == "max_period":
        return _climb_period("clock", plant, family.objective, effort)
    try:
        start = _wirtinger_gain(plant, "given_period")
    except NoDesignError:
        start = _climb_period("clock", plant, "given_period", effort)
    return _climb_rate(plant, start, effort) if family.objective == "decay_rate" else start


def _wirtinger_gain(plant: Plant, objective: str) -> Found:
    """The gain of the convex synthesis. given_period: at half the largest rate it reaches, a compromise of
    speed and margin; decay_rate: close to the largest; max_period: with the rate floor."""
    T = float(plant.sampling.T_max)
    if objective == "max_period":
        return _wirtinger_longest(plant)
    sigma, best = wirtinger.fastest(plant, T)
    if not best.margin > 0:
        raise NoDesignError(f"the Wirtinger inequality was solved for no gain at the period {plant.sampling.T_max}")
    shares = (0.5, 0.25, 0.0) if objective == "given_period" else (0.99, 0.97, 0.9, 0.5)
    for share in shares:
        proposal = wirtinger.redesign(plant, T, share * sigma, best.epsilon)
        L = ExactMatrix.from_floats(proposal.L, GAIN_DIGITS)
        if proposal.margin > 0 and wirtinger.analyse(plant, L, plant.sampling.T_max) is not None:
            return Found(L, plant.sampling.T_max)
    raise NoDesignError(f"no rounded gain could be proved at the period {plant.sampling.T_max}")


def _wirtinger_longest(plant: Plant) -> Found:
    """The gain of the convex synthesis for the longest period with the rate floor."""
    tau = float(plant.sampling.T_max)
    proposal = wirtinger.design(plant, tau, RATE_FLOOR / tau)
    steps = 0
    while not proposal.margin > 0 and steps < _SCAN:
        tau, steps = tau / 1.6, steps + 1
        proposal = wirtinger.design(plant, tau, RATE_FLOOR / tau)
    if not proposal.margin > 0:
        raise NoDesignError(f"the Wirtinger inequality was solved for no gain, down to the period {short(tau)}")
    low, high = tau, 1.6 * tau
    while steps == 0 and (above := wirtinger.redesign(plant, high, RATE_FLOOR / high, proposal.epsilon)).margin > 0 and high < 1e4 * tau:
        low, high, proposal = high, 1.6 * high, above
    while high - low > 5e-4 * low:
        middle = (low + high) / 2
        at_middle = wirtinger.propose(plant, middle, RATE_FLOOR / middle, proposal.epsilon)
        if at_middle.margin > 0:
            low, proposal = middle, at_middle
        else:
            high = middle
    for share in (1.0, 0.9995, 0.998, 0.99, 0.95, 0.9):
        T = short(share * low)
        sigma = _floor(float(T))
        proposal = wirtinger.redesign(plant, float(T), float(sigma), proposal.epsilon)
        L = ExactMatrix.from_floats(proposal.L, GAIN_DIGITS)
        if wirtinger.analyse(plant, L, T, sigma) is not None:
            return Found(L, T)
    raise NoDesignError(f"no rounded gain could be proved at periods up to {short(low)}")


def _floor(T: float, share: float = RATE_FLOOR) -> Fraction:
    return Fraction(str(short(share / T).rational)) if share else Fraction(0)


def _climb_period(method: str, plant: Plant, objective: str, effort: int) -> Found:
    """A gain found by climbing in the period with one method's proof; it starts from the convex synthesis."""
    wanted = float(plant.sampling.T_max)
    start = _wirtinger_longest(plant)
    floor = RATE_FLOOR if objective == "max_period" else 0.0

    def passes(L: ExactMatrix, T: float) -> bool:
        return _prove(method, at_period(plant, short(T)), L, effort, _floor(T, floor)) is not None

    starts = [start.L] if method == "clock" else [start.L, *_stiffer_gains(plant, float(start.T))]
    T, L_start = float(start.T), None
    for _ in range(_SCAN):
        L_start = next((L for L in starts if passes(L, T)), None)
        if L_start is not None:
            break
        T /= 1.6
    if L_start is None:
        raise NoDesignError(f"no gain was proved by {method}, down to the period {short(T)}")
    goal = float("inf") if objective == "max_period" else wanted
    budget = _budget(plant, effort) if method == "clock" else 48 * (1 + effort)
    climb = Climb(passes, _unit(plant, T), budget, goal)
    L, T = climb.run(L_start.floats, T)
    if objective != "max_period" and wanted > T:
        raise NoDesignError(f"the longest period proved by {method} for any gain met is {short(T)}, below {plant.sampling.T_max}")
    if objective != "max_period":
        return Found(L, plant.sampling.T_max)
    level = _headline(plant, effort) if method == "clock" else effort
    further = _largest(method, at_period(plant, short(T)), L, level, RATE_FLOOR)
    return Found(L, short(T) if further is None else further[0])


def _stiffer_gains(plant: Plant, T: float) -> list[ExactMatrix]:
    """Gains of the convex synthesis for shorter periods: Theorem 1 asks for faster error dynamics than the
    longest period leaves."""
    gains = []
    for shorter in (0.8, 0.6, 0.4, 0.25):
        proposal = wirtinger.design(plant, shorter * T, RATE_FLOOR / T)
        if proposal.margin > 0:
            gains.append(ExactMatrix.from_floats(proposal.L, GAIN_DIGITS))
    return gains


def _climb_rate(plant: Plant, start: Found, effort: int) -> Found:
    """A faster gain at one period, by climbing in the rate that the clock certificate proves."""
    T = float(start.T)

    def passes(L: ExactMatrix, sigma: float) -> bool:
        return _prove("clock", plant, L, effort, Fraction(str(short(sigma).rational))) is not None

    sigma = 1.0 / T
    for _ in range(12):
        if passes(start.L, sigma):
            climb = Climb(passes, _unit(plant, T), _budget(plant, effort))
            return Found(climb.run(start.L.floats, sigma)[0], start.T)
        sigma /= 1.6
    return start


def _unit(plant: Plant, T: float) -> Array:
    import numpy as np

    return Units.of(PlantView.floats(plant, {}), T).gain_out(np.ones((plant.n, plant.p)))


def _budget(plant: Plant, effort: int) -> int:
    """How many proofs a climb may try: fewer where each one is large."""
    return max(12, min(160, 20000 // _size(plant))) * (1 + effort)


# The certificates.


def _prove(method: str, plant: Plant, L: ExactMatrix, effort: int, sigma: Fraction) -> Certificate | None:
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
    if _size(plant) > _CLOCK_LARGEST[max(0, min(effort, 3))] or refute(system, 0) is not None:
        return None
    limit = slowest_constant_slope(plant, L) if sigma else None
    if limit is not None and Exact(sigma).ball() >= limit:
        return None
    return clock.analyse(system, effort if _size(plant) <= _CLOCK_SMALL else 0, sigma)


def _headline(plant: Plant, effort: int) -> int:
    """The headline is worth one step more of the schedule than the search for a gain, where that is cheap."""
    return min(effort + 1, 3) if _size(plant) <= _HEADLINE else effort


def _size(plant: Plant) -> int:
    """What a clock certificate costs, roughly: (n + p)^3 times the corners."""
    return int((plant.n + plant.p) ** 3 * 2 ** len(plant.slopes.uncertain))


def _largest(method: str, plant: Plant, L: ExactMatrix, effort: int, floor: float) -> tuple[Exact, Certificate] | None:
    """The largest period one method proves for this gain."""
    start = plant.sampling.T_max

    def prove(T: Exact) -> Certificate | None:
        return _prove(method, at_period(plant, T), L, effort, _floor(float(T), floor))

    # A clock proof costs much more than the others: its search stops earlier.
    tolerance = _TOLERANCE[max(0, min(effort, 3))] if method == "clock" else _FINE
    return largest(prove, start, tolerance)


def _certificates(family: LpvZeroOrderHold, plant: Plant, L: ExactMatrix, effort: int) -> tuple[Certificate, ...]:
    """For each method a proof at the largest period it reaches, and one at the law designed for with the
    largest rate; for the printed theorem the (P, Y) that take it furthest."""
    made: list[Certificate] = []
    for method in _methods(family, plant):
        level = _headline(plant, effort) if method == "clock" else effort
        longest = _largest(method, plant, L, level, 0.0)
        if longest is not None:
            made.append(longest[1])
        rate = _fastest(method, plant, L, level)
        made += [rate] if rate is not None else []
    if family.method == "theorem_1" and family.printed is None:
        printed = _largest("theorem_1", plant, L, effort, 0.0)
        made += [printed[1]] if printed is not None else []
    return tuple(made)


def _fastest(method: str, plant: Plant, L: ExactMatrix, effort: int) -> Certificate | None:
    """The largest rate one method proves under the plant's own law."""

    def prove(sigma: Exact) -> Certificate | None:
        return _prove(method, plant, L, effort, sigma.rational or Fraction(0))

    at_rest = prove(Exact(0))
    if at_rest is None or method == "repaired":  # its line search on alpha is after the rate already
        return at_rest
    found = largest(prove, short(0.5 / float(plant.sampling.T_max)), Fraction(1, 200))
    return at_rest if found is None else found[1]


def _any_gain(plant: Plant, proved: float | None, effort: int) -> tuple[Certificate, ...]:
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
