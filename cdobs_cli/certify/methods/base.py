"""The second seam: a proof method is an object that is its own certificate.

A method proposes itself for a question (`propose`, the only place that may load the solver), is written into
design.json and read from it, and proves itself again from what is written (`prove`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import field, fields, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

from flint import arb

from cdobs_cli.certificate import Certificate, Claim
from cdobs_cli.certify import search
from cdobs_cli.certify.methods.named import Known, loaded
from cdobs_cli.codec import read_fields
from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.exact.numbers import Exact, ExactMatrix, lower_text
from cdobs_cli.hybrid import HybridInclusion
from cdobs_cli.plant import Box, Plant
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.certify.levels import Level

# What the data of a certificate that nobody wrote come to.
UNREADABLE = (KeyError, TypeError, ValueError, IndexError, ExpressionError, ZeroDivisionError, OverflowError)
# Which question a method answers: do errors decay, at a rate; has some gain a proof;
# does this gain fail, or every one; do a paper's conditions hold;
# how large do errors stay, at most or in mean square, and how large does one become.
Reach = Literal[
    "convergence", "some gain", "no convergence", "no gain", "printed conditions", "error bound", "mean square",
    "error attained",
]  # fmt: skip


@dataclass(frozen=True)
class Question:
    """What a method is asked: do the errors of this inclusion decay under its sampling law, at this rate at least?

    rate: sigma >= 0, per time unit. effort: 0..3, how hard a search looks. card: the observer block, for methods
    that read an option of it. memory: what a search keeps from one period or gain to the next; never evidence.
    state: number of the state whose error is to be bounded, where that is what is asked; start: the errors before the
    first sample, where it is asked for all time from them.
    """

    inclusion: HybridInclusion
    rate: Fraction = Fraction(0)
    effort: int = 1
    card: Any = None
    memory: dict[Any, Any] = field(default_factory=dict, compare=False, repr=False)
    state: int | None = None
    start: Box | None = None

    @property
    def law(self) -> SamplingLaw:
        return self.inclusion.sampling

    @property
    def plant(self) -> Plant:
        """The plant under the law asked about."""
        return self.inclusion.plant

    @property
    def level(self) -> int:
        """The effort, within the schedule."""
        return max(0, min(self.effort, 3))

    @property
    def work(self) -> int:
        """About what one search for a quadratic function takes: N^3 times the corners of the slopes."""
        N: int = self.inclusion.floats.base.shape[0]
        return N**3 << len(self.inclusion.quantities)

    def gain(self, letter: str) -> ExactMatrix:
        """A gain by its paper letter. Raises: KeyError."""
        matrix: ExactMatrix = self.inclusion.gain[letter]
        return matrix

    def under(self, law: SamplingLaw) -> Question:
        """The same question under another sampling law."""
        plant = replace(self.plant, sampling=law)
        return replace(self, inclusion=replace(self.inclusion, plant=plant, sampling=law))

    def at(self, T: Exact) -> Question:
        """The same question with the law's period (or largest period) replaced."""
        return self.under(self.law.with_period(T))

    def with_gain(self, gain: Mapping[str, ExactMatrix]) -> Question:
        """The same question about another gain."""
        return replace(self, inclusion=replace(self.inclusion, gain=gain))

    def afresh(self) -> Question:
        """The same question with nothing remembered: what a search finds does not hang on what was asked before."""
        return replace(self, memory={})

    def with_rate(self, sigma: Fraction) -> Question:
        return replace(self, rate=sigma)

    def with_effort(self, effort: int) -> Question:
        return replace(self, effort=effort)

    def started(self, start: Box) -> Question:
        """The same question for all time from these errors before the first sample."""
        return replace(self, start=start)

    def of_state(self, i: int) -> Question:
        """The same question about the error of one state."""
        return replace(self, state=i)


@dataclass(frozen=True)
class Proof:
    """What a method proves of a question: whether its claim holds, at which rate |e| then decays at least (infinite
    for a dead beat), with which margin of its inequalities, where one is known, and how large the error stays, where
    that is what the method is asked."""

    holds: bool
    rate: arb = field(default_factory=arb)
    margin: Fraction | None = None
    error: arb | None = None

    @staticmethod
    def of(holds: bool, sigma: Any = 0, margin: Fraction | None = None) -> Proof:
        """The proof at rate sigma (a Fraction or ball), or none."""
        return Proof(True, arb(_number(sigma)), margin) if holds else NOTHING


def _number(sigma: Any) -> Any:
    from cdobs_cli.exact.functions import fraction_ball

    return fraction_ball(sigma) if isinstance(sigma, Fraction) else sigma


NOTHING = Proof(False)


@dataclass(frozen=True)
class Method(ABC):
    """A certificate. Subclasses are frozen dataclasses of decimal strings and lists of them, as design.json holds
    them; `law` is the sampling law that it is for.

    name: how it is stored. rung: its line in the ladder of methods. source: whose theorem. how: how it is proved.
    statement: what it says, without the law. exact: whether the best gain that it finds is the best there is.
    endless: whether it holds however long the periods are. nonlinear_outputs: whether it takes outputs whose slopes
    vary. of_one_state: whether it is asked about the error of one state (`Question.state`). in_the_mean: whether it
    takes samples that are lost by chance. multirate: whether it takes sensors with periods of their own.
    by_graph: whether it takes those of which several things may happen, as the timed graph tells.
    """

    law: SamplingLaw

    name: ClassVar[str]
    rung: ClassVar[str]
    source: ClassVar[str]
    how: ClassVar[str]
    statement: ClassVar[str] = "The error converges"
    reach: ClassVar[Reach] = "convergence"
    exact: ClassVar[bool] = False
    endless: ClassVar[bool] = False
    nonlinear_outputs: ClassVar[bool] = False
    of_one_state: ClassVar[bool] = False
    in_the_mean: ClassVar[bool] = False
    multirate: ClassVar[bool] = False
    by_graph: ClassVar[bool] = False

    @classmethod
    def applies(cls, question: Question) -> bool:
        """Whether the method takes this error system and law at all (quick)."""
        return cls.nonlinear_outputs or not question.inclusion.outputs

    @classmethod
    def takes_law(cls, law: SamplingLaw) -> bool:
        """Whether it is about laws of this kind: those with one jump at times that are certain are everybody's."""
        return (
            not law.is_on_change
            and (cls.in_the_mean or not law.is_random)
            and (cls.multirate or not law.is_multirate)
            and (cls.by_graph or not law.is_graph)
        )

    @classmethod
    @abstractmethod
    def propose(cls, question: Question) -> Self | None:
        """A certificate for the question's gain, law and rate that is proved already; None where none was found."""

    @classmethod
    def error_guess(cls, question: Question) -> float | None:
        """About what `propose` would prove of the error, by the solver alone; None where it finds nothing. A search's
        compass."""
        return None

    @abstractmethod
    def _prove(self, question: Question) -> Proof:
        """`prove` under the method's own law. Raises anything of UNREADABLE on data that nobody wrote."""

    def prove(self, question: Question) -> Proof:
        """What holds of the question's plant and gain under the method's own law. Loads no solver."""
        if (question.inclusion.outputs and not self.nonlinear_outputs) or not self.takes_law(self.law):
            return NOTHING
        try:
            return self._prove(question.under(self.law))
        except UNREADABLE:
            return NOTHING

    @classmethod
    def longest(cls, question: Question) -> Self | None:
        """The certificate of the longest period found for the question's gain, looked for from its own period."""
        return search.longest(
            lambda T: cls.propose(question.at(T)), question.law.period, search.tolerance(question.effort)
        )

    @property
    def covers(self) -> SamplingLaw:
        """The largest law that the certificate speaks about."""
        return self.law

    @property
    def sentence(self) -> str:
        """What it says, without the law."""
        return self.statement

    def claims(self, question: Question, proof: Proof) -> list[Claim]:
        """The claims about a certificate of the design's own gain and law; the first is what `convergence` rests on."""
        margin = lower_text(proof.rate, 6) if proof.holds and proof.rate > 0 else None
        statement = f"{self.sentence}, sampling {self.covers.words}."
        status: Any = "proved" if proof.holds else "undecided"
        return [Claim(self.rung, "certificate", status, statement, self.source, margin=margin, method=self.how)]

    def quantity(self, plant: Plant) -> str:
        """The name of the bound that a proof's `error` is, `error.<state>`, for methods that have one."""
        raise NotImplementedError(self.name)

    def since(self, plant: Plant) -> str:
        """From which errors on such a bound holds, `from e_x(0) in [-1, 1]`; empty where in the long run."""
        return ""

    def holds_from(self, start: Box) -> bool:
        """Whether such a bound holds for all time from every error of this box before the first sample."""
        return False

    def level(self, question: Question) -> Level | None:
        """The level sets of its function, proved again; None where it has none."""
        return None

    def factor(self, question: Question) -> float | None:
        """c with |e(t)| <= c |e(0)| exp(-rate t) of a proved certificate; None where none is known."""
        return None

    def lost_by_every_gain(self, question: Question) -> Method | None:
        """That every gain fails at a period just above the method's own; None where this method is not exact over all
        gains, or that is not shown."""
        return None

    def certificate(self, gain: Mapping[str, ExactMatrix] | None = None) -> Certificate:
        """As design.json holds it; `gain` where it is about another gain than the design's."""
        data = {one.name: getattr(self, one.name) for one in fields(self) if one.name != "law"}
        texts = {letter: matrix.texts() for letter, matrix in (gain or {}).items()}
        return Certificate(
            self.name, self.law, {name: value for name, value in data.items() if value is not None} | texts
        )


@dataclass(frozen=True)
class Stored:
    """A certificate of a design, read: the method, and the gain that it is about where that is another one."""

    method: Method
    gain: Mapping[str, ExactMatrix] | None


def read(certificate: Certificate, methods: Iterable[Known], letters: Iterable[str] = ()) -> Stored | None:
    """The method that wrote a certificate, of those given; None where none of them did."""
    kind = next(loaded(method for method in methods if method.name == certificate.method), None)
    if kind is None:
        return None
    data = dict(certificate.data)
    try:
        gain = {letter: ExactMatrix(data.pop(letter)) for letter in letters if letter in data}
        return Stored(read_fields(kind, {**data, "law": certificate.sampling.document()}), gain or None)
    except UNREADABLE:
        return None
