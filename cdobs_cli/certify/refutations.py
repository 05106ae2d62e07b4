"""What is refuted of a design, once it is the one that is kept: looked for here, stored with it, and proved again by
`judge`."""

from __future__ import annotations

from collections.abc import Iterator

from cdobs_cli.certify.judge import Judgement
from cdobs_cli.certify.methods.base import Method
from cdobs_cli.certify.methods.counterexample import Attained, Counterexample
from cdobs_cli.certify.methods.dead_beat import resets
from cdobs_cli.certify.unseen import unseen


def refutations(judgement: Judgement) -> Iterator[Method]:
    """Counterexamples of the gain, under its law where nothing proves it there, and at the shortest period above what
    is proved; that every gain fails just above; and how large errors become at least. Loads no solver."""
    question = judgement.question
    if not judgement.covering and judgement.design.outcome != "short" and unseen(judgement.plant) is None:
        here = Counterexample.propose(question)
        if here is not None:
            yield here
    if not (judgement.is_dead_beat and resets(question.inclusion)):
        longest = judgement.longest
        shortest = Counterexample.shortest(question, None if longest is None else longest.T)
        if shortest is not None:
            yield shortest
    exact = judgement.longest_exact
    lost = None if exact is None else exact.method.lost_by_every_gain(question)
    if lost is not None:
        yield lost
    for i in range(judgement.plant.n):
        reached = Attained.propose(question.of_state(i)) if Attained.applies(question) else None
        if reached is not None:
            yield reached
