"""The search for a gain: the convex synthesis, and climbs from it with a method's own proof as objective."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh import wirtinger
from cdobs_cli.families.lpv_zoh.climb import GAIN_DIGITS, Climb
from cdobs_cli.families.lpv_zoh.ladder import clock_is_tried, floor_rate, headline, largest_by, methods, prove_by, size
from cdobs_cli.families.lpv_zoh.laws import at_period, short
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
_SCAN = 24


@dataclass(frozen=True)
class Found:
    """A gain as it is run, and the period for which it was found."""

    L: ExactMatrix
    T: Exact


class NoDesignError(Exception):
    """No gain was found; the message says how far the search went."""


def given(family: LpvZeroOrderHold, plant: Plant, effort: int) -> Found:
    """The given gain; under max_period the largest period proved for it with the rate floor."""
    assert family.gain is not None
    L = family.gain.L
    T = plant.sampling.T_max
    if family.objective == "max_period":
        best = max(
            (float(found[0]) for method in methods(family, plant) if (found := largest_by(method, plant, L, effort, RATE_FLOOR))),
            default=0.0,
        )
        if best > float(T):
            T = short(best)
    return Found(L, T)


def search(family: LpvZeroOrderHold, plant: Plant, effort: int) -> Found:
    """A gain for the objective.

    Raises:
        NoDesignError: with how far the search went.
    """
    if family.method in ("repaired", "theorem_1"):
        return _climb_period(family.method, plant, family.objective, effort)
    if family.method == "wirtinger" or (family.method == "best" and not clock_is_tried(plant, effort)):
        return _wirtinger_gain(plant, family.objective)
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
        sigma = floor_rate(float(T), RATE_FLOOR)
        proposal = wirtinger.redesign(plant, float(T), float(sigma), proposal.epsilon)
        L = ExactMatrix.from_floats(proposal.L, GAIN_DIGITS)
        if wirtinger.analyse(plant, L, T, sigma) is not None:
            return Found(L, T)
    raise NoDesignError(f"no rounded gain could be proved at periods up to {short(low)}")


def _climb_period(method: str, plant: Plant, objective: str, effort: int) -> Found:
    """A gain found by climbing in the period with one method's proof; it starts from the convex synthesis."""
    wanted = float(plant.sampling.T_max)
    start = _wirtinger_longest(plant)
    floor = RATE_FLOOR if objective == "max_period" else 0.0

    def passes(L: ExactMatrix, T: float) -> bool:
        return prove_by(method, at_period(plant, short(T)), L, effort, floor_rate(T, floor)) is not None

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
    level = headline(plant, effort) if method == "clock" else effort
    further = largest_by(method, at_period(plant, short(T)), L, level, RATE_FLOOR)
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
        return prove_by("clock", plant, L, effort, Fraction(str(short(sigma).rational))) is not None

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
    return max(12, min(160, 20000 // size(plant))) * (1 + effort)
