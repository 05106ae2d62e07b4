"""What is refuted of a design, once it is the one that is kept: looked for here, stored with it, and proved again by
`judge`."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

from cdobs_cli.certify import search
from cdobs_cli.certify.judge import Judgement
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.certify.methods.clock.certificate import Clock
from cdobs_cli.certify.methods.counterexample import Attained, Counterexample
from cdobs_cli.certify.methods.dead_beat import resets
from cdobs_cli.certify.unseen import unseen
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.sampling import SamplingLaw

_CERTAIN = "0.999"  # a probability beyond any use
_WIDTH, _DIGITS, _GROWTH = Fraction(1, 2000), 6, 1.02  # of the search for probabilities


def refutations(judgement: Judgement) -> Iterator[Method]:
    """Counterexamples of the gain, under its law where nothing proves it there, and at the shortest period above what
    is proved; that every gain fails just above; and how large errors become at least. Loads no solver."""
    question = judgement.question
    if question.law.is_on_change:  # no word of periods is one of its own
        return
    if not judgement.covering and judgement.design.outcome != "short" and unseen(judgement.plant) is None:
        here = Counterexample.propose(question)
        if here is not None:
            yield here
    if not (judgement.is_dead_beat and resets(question.inclusion)):
        longest = judgement.longest
        shortest = Counterexample.shortest(question, None if longest is None else longest.T)
        if shortest is not None:
            yield shortest
    if question.law.is_random:
        yield from _probabilities(question)
    exact = judgement.longest_exact
    lost = None if exact is None else exact.method.lost_by_every_gain(question)
    if lost is not None:
        yield lost
    for i in range(judgement.plant.n):
        reached = Attained.propose(question.of_state(i)) if Attained.applies(question) else None
        if reached is not None:
            yield reached


def _probabilities(question: Question) -> Iterator[Method]:
    """Of the gain: the largest probability of losses that is proved at its period, and the least that is refuted.
    Uses the solver."""

    def at(probability: Exact) -> Question:
        return question.under(SamplingLaw.randomly(question.law.period, probability)).afresh()

    here, most = question.law.probability, Exact(_CERTAIN)

    def prove(p: Exact) -> Method | None:
        return Clock.propose(at(p)) if p.is_at_most(most) else None

    proved = search.between(prove, here, most, _WIDTH, _DIGITS) or search.largest(prove, here, _WIDTH, digits=_DIGITS)
    if proved is not None:
        yield proved[1]
    start = float(here if proved is None else proved[0])
    refuted = search.smallest(
        lambda p: Counterexample.propose(at(p)), start, _GROWTH, float(_WIDTH) / 10, span=1 / start
    )
    if refuted is not None:
        yield refuted[1]
