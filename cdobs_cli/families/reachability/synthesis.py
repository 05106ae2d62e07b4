"""From a plant and a family block to a design: the gain, and a certificate for each period it is proved at.

Method `set` is the paper's (the set M and LMI (13)), method `clock` needs no structure; `best` asks both and
keeps the better answer. A given K is analysed, an absent one is found.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import clock, dead_beat, planar
from cdobs_cli.certify.unseen import unseen
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact, ExactMatrix, fraction_text
from cdobs_cli.families.reachability.continuous import reference
from cdobs_cli.families.reachability.detectability import undetectable
from cdobs_cli.families.reachability.observer import inclusion
from cdobs_cli.families.reachability.planar_design import PlanarSearch
from cdobs_cli.families.reachability.proof import METHOD
from cdobs_cli.families.reachability.set_design import Found, SetSearch
from cdobs_cli.families.reachability.sets import box_holds
from cdobs_cli.families.reachability.structure import is_chain
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.families.reachability import Reachability
    from cdobs_cli.hybrid import HybridInclusion

# Up to this many states the largest period of the set, over all gains, is looked for whatever the objective.
SMALL = 3


@dataclass(frozen=True)
class Candidate:
    """A gain with its certificate, and its merit under the objective (the largest wins)."""

    K: ExactMatrix
    certificate: Certificate
    merit: float


def synthesize(family: Reachability, plant: Plant, effort: int) -> Design:
    """The design that `family` asks for; outcome `none` with a reason where none is found."""
    return _Synthesis(family, plant, effort).run()


class _Synthesis:
    def __init__(self, family: Reachability, plant: Plant, effort: int) -> None:
        self.family, self.plant, self.effort = family, plant, effort
        self.law = plant.sampling
        self.by_set = family.method in ("best", "set") and self.law.is_periodic
        self.by_clock = family.method in ("best", "clock")
        self.search = SetSearch(family, plant, effort)
        self.planar = PlanarSearch(self._closed_at, self.law.T_max, plant.C) if family.method == "best" and self.by_set else None
        # Where the exact limit is known no other certificate reaches further, and none is looked for.
        given = family.gain.K if family.gain else None
        if self.planar is not None and family.objective != "decay_rate" and self.planar.covers(given):
            self.by_clock = False

    def run(self) -> Design:
        if self.family.gain is not None:
            return self._analyse(self.family.gain.K)
        hidden = unseen(self.plant)
        reason = hidden.sentence(self.plant) if hidden is not None else undetectable(self.plant)
        found = [] if reason else [candidate for candidate in self._candidates() if candidate is not None]
        if not found:
            return self._design("none", self.law, {}, (), reason or self._why_nothing())
        best = max(found, key=lambda candidate: candidate.merit)
        others = tuple(_of_another_gain(candidate) for candidate in found if candidate is not best)
        law = best.certificate.sampling
        own = (best.certificate, *self._at(best.K, law, without=best.certificate.method))
        if best.certificate.method == dead_beat.METHOD:  # no period is too long
            return self._design("found", law, {"K": best.K}, own)
        ladder = self._ladder(best.K, law, {best.certificate.method} if self.family.objective == "max_period" else set())
        return self._design("found", law, {"K": best.K}, (*own, *ladder, *others, *self._any_gain()))

    def _analyse(self, K: ExactMatrix) -> Design:
        hidden = unseen(self.plant)
        if hidden is not None and hidden.period is None:  # no period to look for, with this gain or another
            return self._design("given", self.law, {"K": K}, ())
        own = self._at(K, self.law)
        ladder = () if dead_beat.resets(self._closed(K, self.law)) else self._ladder(K, self.law, set())
        law = self.law
        if self.family.objective == "max_period":
            longer = [certificate.sampling for certificate in ladder if float(certificate.sampling.T_max) > float(law.T_max)]
            law = max(longer, key=lambda sampling: float(sampling.T_max), default=law)
        return self._design("given", law, {"K": K}, (*own, *ladder, *self._any_gain()))

    def _design(
        self, outcome: str, law: SamplingLaw, gain: dict[str, ExactMatrix], certificates: Iterable[Certificate], reason: str | None = None
    ) -> Design:
        kept: dict[str, Certificate] = {}
        for certificate in (*certificates, *reference(self.plant, self.search.log)):
            kept.setdefault(f"{certificate.method} {certificate.sampling} {certificate.data.get('K')}", certificate)
        return Design("reachability", outcome, law, gain, tuple(kept.values()), self.search.log.total, reason)  # type: ignore[arg-type]

    def _candidates(self) -> Iterable[Candidate | None]:
        T = self.law.T_max
        if self.search.kernel.dimension == 0:  # n = rank C: a sample tells the state
            reset = self._dead_beat()
            if reset is not None:
                yield reset
                return
        match self.family.objective:
            case "given_period":
                found = self._from_set(self.search.gain_at(T), 1.0) if self.by_set else None
                if found is None and self.by_clock:
                    found = self._from_clock(clock.design_impulsive(self._open_loop(T), self.effort), 0.0)
                if found is None and self.planar is not None:
                    found = _exact(self.planar.gain_at(T), 0.0)
                yield found
            case "max_period":
                if self.by_set:
                    by_set = self.search.largest_any(T)
                    yield self._from_set(by_set, float(by_set.proof.delta) if by_set else 0.0)
                if self.by_clock:
                    longest = clock.largest_period_design(self._open_loop, T, self.effort)
                    if longest is not None and float(longest[0]) >= float(T):
                        yield self._from_clock(longest[1], float(longest[0]))
                if self.planar is not None:
                    exact = _exact(self.planar.largest_any(), 0.0)
                    if exact is not None and float(exact.certificate.sampling.T_max) >= float(T):
                        yield replace(exact, merit=float(exact.certificate.sampling.T_max))
            case "decay_rate":
                if self.by_set:
                    by_set = self.search.gain_at(T, fast=True)
                    yield self._from_set(by_set, _rate(by_set.certificate) if by_set else 0.0)
                if self.by_clock:
                    yield self._fastest_clock(T)

    def _dead_beat(self) -> Candidate | None:
        """K with K C = I, where that ends as decimals: no error survives the first sample, under any law."""
        K = self.search.kernel.gain(None, 15)
        certificate = dead_beat.analyse(self._closed(K, self.law))
        return None if certificate is None else Candidate(K, certificate, math.inf)

    def _from_set(self, found: Found | None, merit: float) -> Candidate | None:
        return None if found is None else Candidate(found.K, found.certificate, merit)

    def _from_clock(self, found: tuple[object, Certificate] | None, merit: float) -> Candidate | None:
        if found is None:
            return None
        K, certificate = ExactMatrix.from_floats(found[0], clock.GAIN_DIGITS), found[1]  # type: ignore[arg-type]
        # C K = I loses nothing, and only a gain that keeps it exactly can use the reduced (13).
        nearest = self.search.kernel.nearest(K)
        if clock.prove(self._closed(nearest, certificate.sampling), certificate).proved:
            return Candidate(nearest, certificate, merit)
        again = clock.analyse(self._closed(nearest, certificate.sampling), self.effort, clock.rate(certificate))
        if again is not None:
            return Candidate(nearest, again, merit)
        return Candidate(K, certificate, merit) if clock.prove(self._closed(K, certificate.sampling), certificate).proved else None

    def _fastest_clock(self, T: Exact) -> Candidate | None:
        """Bisection on sigma, the decay rate of the clock certificate."""
        found = self._from_clock(clock.design_impulsive(self._open_loop(T), self.effort), 0.0)
        if found is None:
            return None
        low, high = Fraction(0), Fraction(8) / Fraction(float(T))
        for _ in range(5 + 2 * self.effort):
            middle = (low + high) / 2
            sigma = Fraction(fraction_text(Fraction(round(float(middle) * float(T) * 1024), 1024)))
            trial = self._from_clock(clock.design_impulsive(self._open_loop(T), self.effort, sigma / _short(T)), float(sigma / _short(T)))
            if trial is None:
                high = middle
            else:
                low, found = middle, trial
        return found

    def _at(self, K: ExactMatrix, law: SamplingLaw, without: str = "") -> tuple[Certificate, ...]:
        """Certificates of a gain for one law, by each method."""
        certificates: list[Certificate | None] = []
        if without != dead_beat.METHOD:
            certificates.append(dead_beat.analyse(self._closed(K, law)))
        if self.by_set and without != METHOD:
            found = self.search.certificate_at(law.T_max, K)
            certificates.append(found.certificate if found else None)
        if self.by_clock and without in ("", METHOD, planar.METHOD):
            certificates.append(clock.analyse(self._closed(K, law), self.effort))
        if self.planar is not None and self.planar.applies and without != planar.METHOD:
            certificates.append(planar.analyse(self._closed(K, law)))
        return tuple(certificate for certificate in certificates if certificate is not None)

    def _ladder(self, K: ExactMatrix, law: SamplingLaw, done: set[str]) -> tuple[Certificate, ...]:
        """For each method the certificate with the largest period that it proves for this gain."""
        certificates: list[Certificate | None] = []
        if self.by_set and METHOD not in done:
            found = self.search.largest_for(K, law.T_max)
            certificates.append(found.certificate if found else None)
        if self.planar is not None and planar.METHOD not in done:
            certificates.append(self.planar.largest_for(K))
        if self.by_clock and done <= {METHOD, planar.METHOD}:
            longest = clock.largest_period(lambda T: self._closed_at(K, T), law.T_max, self.effort)
            certificates.append(longest[1] if longest else None)
        return tuple(certificate for certificate in certificates if certificate is not None)

    def _any_gain(self) -> tuple[Certificate, ...]:
        """The largest period of the set over all gains, where that is quick."""
        quick = self.plant.n <= SMALL and (is_chain(self.plant) or not self.plant.slopes.uncertain)
        if not self.by_set or not quick or (self.family.objective == "max_period" and self.family.gain is None):
            return ()
        longest = self.search.largest_any(self.law.T_max)
        exact = _exact(self.planar.largest_any(), 0.0) if self.planar is not None else None
        return tuple(_of_another_gain(found) for found in (self._from_set(longest, 0.0), exact) if found is not None)

    def _open_loop(self, T: Exact) -> HybridInclusion:
        zero = ExactMatrix([[0] * self.plant.p for _ in range(self.plant.n)])
        return self._closed(zero, self.law.with_period(T))

    def _closed_at(self, K: ExactMatrix, T: Exact) -> HybridInclusion:
        return self._closed(K, self.law.with_period(T))

    def _closed(self, K: ExactMatrix, law: SamplingLaw) -> HybridInclusion:
        return inclusion(replace(self.plant, sampling=law), {"K": K})

    def _why_nothing(self) -> str:
        T = self.law.T_max
        if self.by_set and not self.by_clock and not box_holds(self.plant, T.ball()):
            return f"the set is known up to delta_star only, and delta = {T} is beyond it; method clock has no such limit"
        asked = {
            "best": "neither the set nor the clock-dependent certificate gave a gain",
            "set": "the set gave no gain",
            "clock": "the clock-dependent certificate gave no gain",
        }
        more = "more effort, a shorter period or smaller slopes may"
        return f"{asked[self.family.method]} with a proof at T = {T}; {more} help"


def _exact(found: tuple[ExactMatrix, Certificate] | None, merit: float) -> Candidate | None:
    return None if found is None else Candidate(found[0], found[1], merit)


def _of_another_gain(candidate: Candidate) -> Certificate:
    certificate = candidate.certificate
    return Certificate(certificate.method, certificate.sampling, {**certificate.data, "K": candidate.K.texts()})


def _rate(certificate: Certificate) -> float:
    rho_squared = float(certificate.data["rho_squared"])
    return -math.log(rho_squared) / (2 * float(certificate.sampling.T_max)) if rho_squared > 0 else math.inf


def _short(T: Exact) -> Fraction:
    return T.rational if T.rational is not None else Fraction(float(T)).limit_denominator(10**6)
