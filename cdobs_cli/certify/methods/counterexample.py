"""What a gain is shown not to do, as certificates: a word of slopes that its error does not survive, and a word of
slopes and signals that makes its error large. Searches find them, in floats; balls prove them, here and again later.
"""

from __future__ import annotations

from typing import Any, ClassVar, Self

from cdobs_cli.certificate import Witness
from cdobs_cli.certify.falsify import refute
from cdobs_cli.certify.methods.base import NOTHING, Method, Proof, Question, Reach
from cdobs_cli.certify.words import refutes
from cdobs_cli.design import COUNTEREXAMPLE
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.records import dataclass


@dataclass(frozen=True)
class Counterexample(Method):
    """Under its law some error of the gain does not decay.

    witness: the word, as `words` writes it.
    """

    witness: dict[str, Any]

    name: ClassVar[str] = COUNTEREXAMPLE
    rung: ClassVar[str] = "counterexample"
    source: ClassVar[str] = "spectral radius of a word of slopes and periods"
    how: ClassVar[str] = "monodromy matrix in balls"
    statement: ClassVar[str] = "Some error does not decay"
    reach: ClassVar[Reach] = "no convergence"
    nonlinear_outputs: ClassVar[bool] = True
    in_the_mean: ClassVar[bool] = True
    multirate: ClassVar[bool] = True
    by_graph: ClassVar[bool] = True

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        met = refute(question.inclusion, question.effort)
        return None if met is None else cls(question.law, met.document())

    @classmethod
    def shortest(cls, question: Question, above: Exact | None) -> Self | None:
        """That of the shortest period found above one: of the question's law with its period replaced."""
        from cdobs_cli.certify.bracket import smallest_refuted

        met = smallest_refuted(lambda T: question.at(T).inclusion, above, question.effort)
        return None if met is None else cls(question.law.with_period(met[0]), met[1].document())

    def _prove(self, question: Question) -> Proof:
        return Proof.of(refutes(question.inclusion, Witness.from_document(self.witness)))


@dataclass(frozen=True)
class Attained(Method):
    """Under its law the error of one state comes to this size again and again: `Proof.error`, from below.

    state: its number. witness: the word, as `adversary` writes it.
    """

    state: int
    witness: dict[str, Any]

    name: ClassVar[str] = "attained"
    rung: ClassVar[str] = "attained"
    source: ClassVar[str] = "the adversary's word, in balls"
    how: ClassVar[str] = "periodic solution of a word"
    reach: ClassVar[Reach] = "error attained"
    nonlinear_outputs: ClassVar[bool] = True
    of_one_state: ClassVar[bool] = True

    @classmethod
    def applies(cls, question: Question) -> bool:
        """Where what acts is bounded."""
        inclusion = question.inclusion
        known = question.plant.has_only_bounded and question.law.is_bounded
        return known and inclusion.assemble_noise is not None

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        from cdobs_cli.certify.adversary import attained

        assert question.state is not None
        if not cls.applies(question):
            return None
        met = attained(question.inclusion, question.state, question.effort)
        return None if met is None else cls(question.law, question.state, met[1].document())

    def _prove(self, question: Question) -> Proof:
        from cdobs_cli.certify.adversary import attains

        witness = Witness.from_document(self.witness)
        reached = attains(question.inclusion, witness)
        if reached is None or not reached > 0 or witness.data["state"] != self.state:
            return NOTHING
        return Proof(True, error=reached)
