"""What the tests of this family ask of the set M."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from designing import designed

from cdobs_cli.certificate import Check
from cdobs_cli.certify.methods.base import Question, read
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.families.reachability.certificate import ReachableSet, SetProof
from cdobs_cli.families.reachability.set_design import Gain, gain_at, longest_any
from cdobs_cli.plant import Plant

Case = tuple[Reachability, Plant]


def run(family: Reachability, p: Plant, effort: int = 1) -> tuple[Design, Check]:
    """Both verbs."""
    design = designed(family, p, effort)
    return design, family.certify(p, design, effort)


@dataclass(frozen=True)
class Found:
    """A gain's error system, with the certificate found for it."""

    question: Question
    certificate: ReachableSet

    @property
    def K(self) -> ExactMatrix:
        return self.question.gain("K")

    @property
    def proof(self) -> SetProof:
        proof = self.certificate.prove(self.question)
        assert isinstance(proof, SetProof)
        return proof

    @property
    def P(self) -> Any:
        """P of (13), in floats."""
        return self.certificate.lyapunov_matrix(self.question.plant, self.K).floats

    def holds_for(self, K: ExactMatrix) -> bool:
        """Whether the certificate proves another gain."""
        return self.certificate.prove(self.question.with_gain({"K": K})).holds

    def holds_with(self, **data: Any) -> bool:
        """Whether the stored certificate, with some of its data replaced, is proved."""
        kept = self.certificate.certificate()
        stored = read(replace(kept, data={**kept.data, **data}), (ReachableSet,))
        return stored is not None and stored.method.prove(self.question).holds


def found(case: Case, gain: Any = None) -> Found | None:
    """A certificate for the given gain, or a gain and its certificate, at the plant's period."""
    family, p = case
    if gain is None:
        return _with(case, gain_at(family.question(p, {}, 1)))
    question = family.question(p, {"K": ExactMatrix(gain)}, 1)
    certificate = ReachableSet.propose(question)
    return None if certificate is None else Found(question, certificate)


def found_at(case: Case, T: str) -> Found | None:
    """A gain and its certificate at another period."""
    return found((case[0], replace(case[1], sampling=case[1].sampling.with_period(Exact(T)))))


def longest_of(case: Case) -> Found | None:
    """The gain of the longest period, from the plant's own."""
    return _with(case, longest_any(case[0].question(case[1], {}, 1)))


def _with(case: Case, met: Gain | None) -> Found | None:
    family, p = case
    return None if met is None else Found(family.question(p, {"K": met[0]}, 1), met[1])
