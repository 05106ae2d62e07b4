"""One plant with one design, and what is decided of it: read by every group of claims."""

from __future__ import annotations

from dataclasses import field
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

from flint import arb

from cdobs_cli.certificate import Bound, Claim, Status, Witness
from cdobs_cli.certify.methods.base import Method, Proof, Question, read
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.families.interval.cone import Cone
from cdobs_cli.families.interval.hurwitz import Hurwitz, width_contracts
from cdobs_cli.families.interval.method import SOURCE
from cdobs_cli.families.interval.observer import inclusion
from cdobs_cli.families.interval.system import System
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.families.interval import Interval

Kind = TypeVar("Kind", bound=Method)


@dataclass
class Analysis:
    """One plant with one design: claims and bounds as they are decided.

    Everything is read from the typed plant, the printed gain and the stored certificates.
    """

    family: Interval
    plant: Plant
    design: Design
    effort: int
    claims: list[Claim] = field(default_factory=list)
    bounds: dict[str, Bound] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)
    _proofs: dict[type[Method], list[tuple[Any, Proof]]] = field(default_factory=dict)

    @property
    def law(self) -> SamplingLaw:
        return self.design.sampling

    @cached_property
    def T(self) -> arb:
        """The largest period of the law."""
        return self.law.T_max.ball()

    @cached_property
    def question(self) -> Question:
        """Plant and gain under the design's law."""
        return Question(inclusion(self.plant, self.design.gain), effort=self.effort, card=self.family).under(self.law)

    @cached_property
    def system(self) -> System:
        return System.of(self.question)

    def proved(self, kind: type[Kind]) -> list[tuple[Kind, Proof]]:
        """The stored certificates of a kind that are proved, with their proofs."""
        if kind not in self._proofs:
            stored = [read(certificate, (kind,)) for certificate in self.design.certificates]
            proofs = [(one.method, one.method.prove(self.question)) for one in stored if one is not None]
            self._proofs[kind] = [(method, proof) for method, proof in proofs if proof.holds]
        return self._proofs[kind]

    def own(self, kind: type[Kind]) -> Kind | None:
        """The proved certificate of the design's law."""
        return next((method for method, _ in self.proved(kind) if method.law == self.law), None)

    def periods(self, kind: type[Kind]) -> list[Exact]:
        """Largest periods of the proved certificates whose law is the design's with its period replaced."""
        laws = [method.law for method, _ in self.proved(kind)]
        return [law.T_max for law in laws if law == self.law.with_period(law.T_max)]

    @property
    def ordered(self) -> bool:
        """Whether E(s) >= 0 is proved up to the law's largest period: errors in the orthant stay there."""
        return self.system.limit.holds_until(self.T)

    @property
    def is_hull(self) -> bool:
        """Whether the observer run is the hull predictor."""
        return self.family.tighten == "hull"

    @cached_property
    def cone(self) -> Cone | None:
        """The stored cone of the law, where it is proved to hold the errors."""
        return self.own(Cone)

    @cached_property
    def shrinks(self) -> bool:
        """Whether the errors in the cone of the law are proved to shrink."""
        return self.cone is not None and self.cone.shrinks(self.system.errors)

    def enclosed_by_cones(self, *, bounded: bool = False) -> list[Exact]:
        """Largest periods for which a stored cone is proved to hold the errors, and they to stay bounded if asked."""
        cones = [cone for cone, _ in self.proved(Cone) if cone.law == self.law.with_period(cone.law.T_max)]
        return [cone.law.T_max for cone in cones if not bounded or cone.shrinks(self.system.errors)]

    @cached_property
    def hurwitz_rate(self) -> arb | None:
        """The rate that w* proves; None where it proves none."""
        return next((proof.rate for _, proof in self.proved(Hurwitz)), None)

    @cached_property
    def contracts(self) -> bool:
        """Whether the map of the width from sample to sample is proved to contract in the norm of w*."""
        return any(width_contracts(self.system, one.w_star.balls(), self.law) for one, _ in self.proved(Hurwitz))

    @property
    def departs(self) -> bool:
        """Whether given S and L are not those of the observer (12): then nothing is claimed in its name. (The
        proofs themselves couple whatever signs Q1 has, and serve found gains as they are.)"""
        return bool(self.system.structure) and self.design.outcome == "given"

    def status(self, identifier: str) -> Status | None:
        """The status of a claim made already."""
        return next((claim.status for claim in self.claims if claim.id == identifier), None)

    def say(
        self, identifier: str, kind: Any, status: Status, statement: str, source: str = SOURCE, *,
        margin: str | None = None, method: str | None = None, witness: Witness | None = None, reason: str | None = None,
    ) -> Status:  # fmt: skip
        """Note a claim; `reason` says in a clause why it is refuted."""
        if reason is not None:
            self.reasons[identifier] = reason
            statement = f"{statement}; {reason}"
        claim = Claim(identifier, kind, status, statement, source, margin=margin, method=method, witness=witness)
        self.claims.append(claim)
        return status
