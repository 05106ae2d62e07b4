"""Counterexamples looked for: words of slopes and sampling periods, in floats, the most unstable first; `words` proves
them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from fractions import Fraction
from itertools import islice, product
from typing import TYPE_CHECKING, Any

import numpy as np
from flint import arb

from cdobs_cli import progress
from cdobs_cli.certificate import Witness
from cdobs_cli.certify.ball import spectral_radius_lower
from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.certify.linear import product as cycle
from cdobs_cli.certify.symmetric_power import power
from cdobs_cli.certify.walks import walks
from cdobs_cli.certify.words import Arc, Word, leaves_unseen, prove
from cdobs_cli.exact.numbers import Exact, decimal_text, upper_text
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion
from cdobs_cli.plant import Quantity
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_ALL_CORNERS = 10  # up to 2^10 corners are all tried, beyond that an ascent picks some
_PERIOD_WORDS = 6
_MOST_JUMPS = 64  # corners of the jump that are tried
_LEAST_CHANCE = 1e-9  # a probability that no number below it says more than
_MOST_IN_THE_MEAN = 8  # states of an error whose E e e' is followed
_SLACK = 1e-7  # how far below 1 a float spectral radius may be for a proof to be tried


def refute(inclusion: HybridInclusion, effort: int) -> Witness | None:
    """A proved counterexample under the inclusion's sampling law, or None.

    Tries constant slopes that leave an error unseen for ever; constant slopes at the corners of the box, at
    periods the law contains; words of mixed periods for a linear loop; and from effort 1 on V(t) that switch
    between corners, over words of several periods.
    """
    progress.doing(f"counterexamples at T = {float(inclusion.sampling.period):.6g}")
    with np.errstate(all="ignore"):
        for words in _searches(inclusion.sampling):
            for word in words(inclusion, effort):
                multiplier = prove(inclusion, word)
                if multiplier is not None:
                    return word.witness(inclusion, multiplier)
    return None


def _searches(law: SamplingLaw) -> tuple[Callable[[HybridInclusion, int], Iterator[Word]], ...]:
    if law.is_on_change:  # when messages come hangs on the error
        return ()
    if law.is_random:
        return (_mean_words,)
    if law.is_multirate:
        return _unseen_words, _cyclic_words, _switching_words
    if law.is_graph:
        return _walked_words, _switching_words
    return _unseen_words, _constant_words, _period_words, _switching_words


def _unseen_words(inclusion: HybridInclusion, effort: int) -> Iterator[Word]:
    """Constant slopes with an unseen error that does not decay: corners (few of them) and the middle."""
    if inclusion.sampling.T_max.sign() != 1:
        return
    candidates = [_values(inclusion, corner) for corner in islice(candidate_corners(inclusion), 16)]
    candidates += _inner(inclusion.quantities)
    for values, w in product(candidates, _inner(inclusion.outputs)):
        if leaves_unseen(inclusion, values, w):
            gaps = inclusion.sampling.gaps or (inclusion.sampling.T_max,)
            yield Word(tuple((Arc(gap, values),) for gap in gaps), (w,) * len(gaps) if w else ())


def _inner(quantities: tuple[Quantity, ...]) -> list[tuple[Exact, ...]]:
    """The middle of the slopes, and those nearest to 0, where their ends are rational."""
    ends = [(rho.lower.rational, rho.upper.rational) for rho in quantities]
    known = [(low, high) for low, high in ends if low is not None and high is not None]
    if len(known) < len(ends):
        return []
    middle = tuple(Exact((low + high) / 2) for low, high in known)
    return [middle, tuple(Exact(min(max(low, Fraction(0)), high)) for low, high in known)] if known else [()]


def _switching_words(inclusion: HybridInclusion, effort: int) -> Iterator[Word]:
    """Bang-bang slopes over one or several periods: what `switching` proposes, the most unstable first."""
    from cdobs_cli.certify.switching import propose

    if not all(map(_finite, inclusion.phases_floats)):
        return
    for proposal in propose(inclusion, effort)[:4]:
        if proposal.radius < 1 - _SLACK:
            return
        periods = []
        for T, arcs in zip(proposal.periods, proposal.arcs, strict=True):
            lengths = [Exact(decimal_text(length, 10)) for length, _ in arcs[:-1]]
            last = T
            for length in lengths:
                last = last - length
            periods.append(
                tuple(
                    Arc(length, _values(inclusion, corner))
                    for length, (_, corner) in zip([*lengths, last], arcs, strict=True)
                )
            )
        samples = (ends_of(inclusion.outputs, corner) for corner in proposal.jumps)
        readings = proposal.readings if inclusion.sampling.is_graph else ()
        yield Word(tuple(periods), tuple(samples) if inclusion.outputs else (), readings)


def _period_words(inclusion: HybridInclusion, effort: int) -> Iterator[Word]:
    """No uncertain slope, an interval of periods: what `period_words` proposes, in decimals inside the law."""
    from cdobs_cli.certify.period_words import propose

    law, maps = inclusion.sampling, inclusion.floats
    low, high = law.T_min, law.T_max
    if inclusion.entries or inclusion.outputs or low == high or high.sign() != 1 or not _finite(maps):
        return
    grid = tuple(map(float, law.multiples))
    for proposal in propose(maps.base, maps.jump, float(low), float(high), effort, grid)[:_PERIOD_WORDS]:
        if proposal.radius < 1 - _SLACK:
            return
        periods = []
        for period in proposal.periods:
            T = Exact(decimal_text(period, 12))
            ends = law.multiples or tuple(end for end in (low, high) if end.sign() == 1 and not law.allows(T))
            periods.append(min(ends, key=lambda end: abs(float(end) - period)) if ends else T)
        yield Word(tuple((Arc(T, ()),) for T in periods))


def _constant_words(inclusion: HybridInclusion, effort: int) -> Iterator[Word]:
    """Constant corners, of flow and jump, the most unstable in floats first, at each period worth a try."""
    maps = inclusion.floats
    corners = list(candidate_corners(inclusion))
    if not _finite(maps):
        return
    flows = np.array([maps.flow(_floats(inclusion, corner)) for corner in corners])
    jumps = list(islice(product((False, True), repeat=len(inclusion.outputs)), _MOST_JUMPS))
    found = []
    for T in candidate_periods(inclusion.sampling, effort):
        Phi = exponentials(flows * float(T))
        for bits in jumps:
            w = ends_of(inclusion.outputs, bits)
            J = maps.jump_at(tuple(map(float, w)))
            for corner, rho in zip(corners, spectral_radii(J @ Phi), strict=True):
                if rho >= 1 - _SLACK:
                    found.append((rho, T, corner, w))
    found.sort(key=lambda item: -item[0])
    for _, T, corner, w in found[:8]:
        yield Word(((Arc(T, _values(inclusion, corner)),),), (w,) if w else ())


def _cyclic_words(inclusion: HybridInclusion, effort: int) -> Iterator[Word]:
    """Constant slopes over a hyperperiod: corners, of flow and of all jumps, the middle and the slopes nearest to 0;
    the most unstable in floats first."""
    phases, gaps = inclusion.phases_floats, inclusion.sampling.gaps
    if not all(map(_finite, phases)):
        return
    slopes = [_values(inclusion, corner) for corner in islice(candidate_corners(inclusion), 2**_ALL_CORNERS)]
    slopes += _inner(inclusion.quantities) if inclusion.quantities else []
    flows = np.array([phases[0].flow(tuple(map(float, values))) for values in slopes])
    steps = {gap: exponentials(flows * float(gap)) for gap in set(gaps)}
    found = []
    for bits in islice(product((False, True), repeat=len(inclusion.outputs)), _MOST_JUMPS):
        w = ends_of(inclusion.outputs, bits)
        jumps = [maps.jump_at(tuple(map(float, w))) for maps in phases]
        radii = spectral_radii(cycle((steps[gap] for gap in gaps), jumps))
        found += [(rho, values, w) for rho, values in zip(radii, slopes, strict=True) if rho >= 1 - _SLACK]
    found.sort(key=lambda item: -item[0])
    for _, values, w in found[:8]:
        yield Word(tuple((Arc(gap, values),) for gap in gaps), (w,) * len(gaps) if w else ())


def _walked_words(inclusion: HybridInclusion, effort: int) -> Iterator[Word]:
    """Constant corners, of flow and of all jumps, along ways through the timed graph; the most unstable in floats
    first."""
    phases = inclusion.phases_floats
    if not all(map(_finite, phases)):
        return
    slopes = [_values(inclusion, corner) for corner in islice(candidate_corners(inclusion), 2**_ALL_CORNERS)]
    flows = np.array([phases[0].flow(tuple(map(float, values))) for values in slopes])
    steps: dict[Exact, Array] = {}
    found: list[tuple[float, Word]] = []
    for walk in walks(inclusion.sampling):
        for gap in walk.gaps:
            if gap not in steps:
                steps[gap] = exponentials(flows * float(gap))
        for bits in islice(product((False, True), repeat=len(inclusion.outputs)), _MOST_JUMPS):
            w = ends_of(inclusion.outputs, bits)
            M = np.eye(phases[0].base.shape[0])[None]
            for gap, reading in zip(walk.gaps, walk.readings, strict=True):
                M = (
                    steps[gap] @ M
                    if reading is None
                    else phases[reading].jump_at(tuple(map(float, w))) @ steps[gap] @ M
                )
            for radius, values in zip(spectral_radii(M), slopes, strict=True):
                if radius >= 1 - _SLACK:
                    periods = tuple((Arc(gap, values),) for gap in walk.gaps)
                    found.append((float(radius), Word(periods, (w,) * len(periods) if w else (), walk.readings)))
    found.sort(key=lambda one: -one[0])
    yield from (word for _, word in found[:8])


def _mean_words(inclusion: HybridInclusion, effort: int) -> Iterator[Word]:
    """Constant corners, the one first for which E e e' grows most at a sample that is lost by chance."""
    maps, law = inclusion.floats, inclusion.sampling
    if not _finite(maps) or maps.base.shape[0] > _MOST_IN_THE_MEAN:
        return
    p, found = float(law.probability), []
    for corner in islice(candidate_corners(inclusion), 2**_ALL_CORNERS):
        F = exponentials(maps.flow(_floats(inclusion, corner))[None] * float(law.T_min))[0]
        if not np.all(np.isfinite(F)):
            return
        for bits in islice(product((False, True), repeat=len(inclusion.outputs)), _MOST_JUMPS):
            w = ends_of(inclusion.outputs, bits)
            JF = maps.jump_at(tuple(map(float, w))) @ F
            mean = np.array(power(JF, 2)) * (1 - p) + np.array(power(F, 2)) * p
            radius = spectral_radii(mean[None])[0]
            if radius >= 1 - _SLACK:
                found.append((radius, corner, w))
    found.sort(key=lambda item: -item[0])
    for _, corner, w in found[:2]:
        yield Word(((Arc(law.T_min, _values(inclusion, corner)),),), (w,) if w else ())


def candidate_periods(law: SamplingLaw, effort: int) -> list[Exact]:
    """Periods of the law worth a try: its ends, and for an interval some between (0 is never used: a law
    from 0 contains arbitrarily short periods, not the period 0)."""
    ends = [T for T in (law.T_max, law.T_min) if T.sign() == 1]
    if law.is_lossy:
        return list(law.multiples[::-1])
    if law.is_periodic or not ends:
        return ends[:1]
    low, high = law.T_min.rational, law.T_max.rational
    if low is None or high is None:
        return ends
    count = 4 * 2**effort
    between = [Exact(low + (high - low) * Fraction(k, count)) for k in range(1, count)]
    return ends + between


def candidate_corners(inclusion: HybridInclusion) -> Iterator[tuple[bool, ...]]:
    """Corners of the slope box (True: upper end): all of them while few, else those with one or two
    sign patterns by rows, and an ascent of the spectral radius from them."""
    count = len(inclusion.quantities)
    if count <= _ALL_CORNERS:
        yield from product((False, True), repeat=count)
        return
    maps = inclusion.floats
    T = float(inclusion.sampling.T_max)

    def radii(batch: list[tuple[bool, ...]]) -> Array:
        flows = np.array([maps.flow(_floats(inclusion, corner)) for corner in batch])
        return spectral_radii(maps.jump @ exponentials(flows * T))

    starts = [
        (False,) * count,
        (True,) * count,
        tuple(k % 2 == 0 for k in range(count)),
        tuple(i <= j for i, j in inclusion.entries),
    ]
    for start in starts:
        best, value = start, float(radii([start])[0])
        for _ in range(3):
            flips = [tuple(bit != (k == flip) for k, bit in enumerate(best)) for flip in range(count)]
            values = radii(flips)
            top = int(np.argmax(values))
            if not values[top] > value:
                break
            best, value = flips[top], float(values[top])
        yield best
    yield from starts


def _values(inclusion: HybridInclusion, corner: tuple[bool, ...]) -> tuple[Exact, ...]:
    return ends_of(inclusion.quantities, corner)


def ends_of(quantities: tuple[Quantity, ...], corner: tuple[bool, ...]) -> tuple[Exact, ...]:
    """The values at a corner (True: upper end)."""
    return tuple(rho.upper if up else rho.lower for up, rho in zip(corner, quantities, strict=True))


def _floats(inclusion: HybridInclusion, corner: tuple[bool, ...]) -> tuple[float, ...]:
    return tuple(float(value) for value in _values(inclusion, corner))


def _finite(maps: ErrorMaps[Any]) -> bool:
    parts = (maps.base, maps.jump, *maps.parts, np.array(maps.lower), np.array(maps.upper), *maps.jump_parts)
    return all(bool(np.all(np.isfinite(part))) for part in parts)


def every_gain_fails_from(inclusion: HybridInclusion) -> str | None:
    """A probability of losses from which on no gain keeps E |e|^2 from growing: rho(F)^-2, F what the plant makes of an
    error over a period without a sample, at the constant corner where that is largest; None where errors do not grow.

    After k samples all of which are lost, which has the probability p^k, E |e|^2 has grown by rho(F)^2k."""
    view, T = inclusion.view_balls, inclusion.sampling.period
    corners = [_values(inclusion, corner) for corner in islice(candidate_corners(inclusion), 2**_ALL_CORNERS)]
    floats = np.array([inclusion.view_floats.flow(map(float, corner)) for corner in corners])
    if not np.all(np.isfinite(floats)):
        return None
    worst = corners[int(np.argmax(spectral_radii(exponentials(floats * float(T)))))]
    rho = spectral_radius_lower(view.flow(value.scalar for value in worst).exp(T.scalar))
    return upper_text((1 / rho**2).max(arb(_LEAST_CHANCE)), 9) if rho > 1 else None


def slowest_decay(inclusion: HybridInclusion) -> arb | None:
    """A rate that the error certainly does not exceed: -ln(rho) / T of the sampled error at the worst corner of the
    slope box and of the jump, at the largest period; None where no corner gives one (or the loop is unstable there)."""
    law = inclusion.sampling
    gaps = law.gaps or (law.T_max,)
    phases, exact = inclusion.phases_floats, inclusion.phases_balls
    corners = [_values(inclusion, corner) for corner in candidate_corners(inclusion)]
    flows = np.array([phases[0].flow(tuple(float(v) for v in corner)) for corner in corners])
    if not np.all(np.isfinite(flows)):
        return None
    jumps = list(zip(*(islice(maps.jumps(), _MOST_JUMPS) for maps in phases), strict=True))
    with np.errstate(all="ignore"):  # overflow at periods beyond any use
        steps = {gap: exponentials(flows * float(gap)) for gap in set(gaps)}
        radii = np.array([spectral_radii(cycle((steps[gap] for gap in gaps), J)) for J in jumps])
    number, worst = np.unravel_index(int(np.argmax(radii)), radii.shape)
    F = exact[0].flow(tuple(v.scalar for v in corners[int(worst)]))
    Phi = {gap: F.exp(gap.scalar) for gap in set(gaps)}
    J = [next(islice(maps.jumps(), int(number), None)) for maps in exact]
    rho = spectral_radius_lower(cycle((Phi[gap] for gap in gaps), J))
    if not 0 < rho < 1:
        return None
    return -rho.log() / (law.hyperperiod if law.is_multirate else law.T_max).ball()
