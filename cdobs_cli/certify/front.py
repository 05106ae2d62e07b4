"""The front: what rate or error can be had at which period, each point with a gain of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

from flint import arb

from cdobs_cli.certify import accuracy, search
from cdobs_cli.certify.gains import Candidate, NoDesignError
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.certify.methods.rung import GENERAL
from cdobs_cli.design import FrontPoint
from cdobs_cli.exact.numbers import ExactMatrix, lower_text, upper_text
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

# Periods looked at, in parts of the law's own; those beyond it up to the first that gives no gain.
_SHORTER = (0.35, 0.7)
_LONGER = (1.4, 2.0, 2.8, 4.0)
_LARGEST = 110  # `Question.work`: beyond that the points take too long
_DIGITS = 6


@dataclass(frozen=True)
class Point:
    """A gain for one period, its rate and the errors that are proved of it."""

    law: SamplingLaw
    gain: ExactMatrix
    rate: arb | None
    errors: dict[str, arb]

    def better(self, other: Point) -> bool:
        """Whether its errors are smaller in the mean over the states, on a scale of factors; without errors, whether
        it is faster."""
        if self.errors and other.errors:
            mine, others = (sum((error.log() for error in one.errors.values()), arb(0)) for one in (self, other))
            return bool(mine < others)
        return self.rate is not None and (other.rate is None or bool(self.rate > other.rate))

    def document(self, letter: str) -> FrontPoint:
        """As design.json holds it."""
        rate = None if self.rate is None or not self.rate > 0 else lower_text(self.rate, _DIGITS)
        errors = {name: upper_text(error, _DIGITS) for name, error in self.errors.items()}
        return FrontPoint(str(self.law.period), rate, errors, {letter: self.gain})


def front(
    question: Question, letter: str, find: Callable[[Question], Candidate | None], own: ExactMatrix
) -> tuple[FrontPoint, ...]:
    """Points by increasing period, each at least as good as what a proof for a law that holds it gives; empty where no
    other period has a gain, and for large plants.

    Args:
        question: under the design's law; every point is looked at with little effort, this design's too.
        find: a gain for a question's law; own: the design's.
    """
    law = question.law
    if question.work > _LARGEST:
        return ()
    points: list[Point] = []
    for share in _SHORTER:
        points += _found(question.at(search.short(share * float(law.period), 3)), letter, find)
    for share in _LONGER:
        further = _found(question.at(search.short(share * float(law.period), 3)), letter, find)
        if not further:
            break
        points += further
    if not points:
        return ()
    points.append(_point(question.with_effort(0), letter, Candidate(own, law, 0.0, GENERAL.propose(question.afresh()))))
    return tuple(one.document(letter) for one in running_best(points, law))


def running_best(points: Iterable[Point], law: SamplingLaw) -> Sequence[Point]:
    """By increasing period: a proof for [T_min, T] serves every [T_min, T'] inside, one for a constant period that
    period only."""
    kept: list[Point] = []
    best: Point | None = None
    for point in sorted(points, key=lambda one: -float(one.law.period)):
        if best is not None and best.law.contains(point.law) and best.better(point):
            point = Point(point.law, best.gain, best.rate, best.errors)
        else:
            best = point
        kept.append(point)
    return tuple(reversed(kept))


def _found(question: Question, letter: str, find: Callable[[Question], Candidate | None]) -> list[Point]:
    try:
        candidate = find(question.afresh().with_effort(0))
    except NoDesignError:
        return []
    return [] if candidate is None else [_point(question.with_effort(0), letter, candidate)]


def _point(question: Question, letter: str, candidate: Candidate) -> Point:
    about = question.with_gain({letter: candidate.gain})
    rate = None if candidate.method is None else _rate(candidate.method, about)
    return Point(question.law, candidate.gain, rate, accuracy.of_states(about))


def _rate(method: Method, question: Question) -> arb | None:
    proof = method.prove(question)
    return proof.rate if proof.holds and proof.rate.is_finite() else None
