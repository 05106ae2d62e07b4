"""Which certificates are looked for, and how hard: Wirtinger's inequality, the clock certificate where the plant is
small enough, the repaired Theorem 1 for its class.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import search
from cdobs_cli.certify.cuts import MOST_CORNERS
from cdobs_cli.certify.design import Beyond
from cdobs_cli.certify.falsify import refute, slowest_decay
from cdobs_cli.certify.methods.any_gain import NoGain
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.certify.methods.rung import GENERAL, One, Rung, longest_at
from cdobs_cli.certify.methods.wirtinger.certificate import Wirtinger
from cdobs_cli.certify.methods.wirtinger.design import size
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.families.lpv_zoh.curve import Curve, gain_curve
from cdobs_cli.families.lpv_zoh.printed_search import PrintedTheorem1
from cdobs_cli.families.lpv_zoh.repaired import Repaired
from cdobs_cli.families.lpv_zoh.structure import is_class_16
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold

# Sizes up to which a clock certificate gets one step more of the schedule for the headline, the whole schedule,
# or (by effort) a search at all.
_HEADLINE, _WHOLE = 700, 2_000
_LARGEST = (15_000, 15_000, 70_000, 200_000)
_GROWTH, _WIDTH = 1.15, 1e-5  # of the search for a period that no gain survives
_SPAN = 1.15**24
_SHORTER = (1 / 40, 1 / 1600)


def clock_is_tried(question: Question) -> bool:
    """Whether the plant is small enough for clock certificates at this effort."""
    return size(question.plant) <= _LARGEST[question.level]


def headline(question: Question) -> Question:
    """The headline is worth one step more of the schedule than the search for a gain, where that is cheap."""
    return question.with_effort(min(question.effort + 1, 3)) if size(question.plant) <= _HEADLINE else question


@dataclass(frozen=True)
class ClockRung:
    """The general certificates, asked for only where no counterexample stands against them: a search that fails is the
    dearest."""

    name: str = GENERAL.name

    def propose(self, question: Question) -> Method | None:
        if not clock_is_tried(question) or refute(question.inclusion, 0) is not None:
            return None
        limit = slowest_decay(question.inclusion) if question.rate else None
        if limit is not None and Exact(question.rate).ball() >= limit:
            return None
        return GENERAL.propose(self.taken(question))

    def longest(self, question: Question, share: float = 0.0) -> Method | None:
        return GENERAL.longest(self.taken(question), share) if clock_is_tried(question) else None

    def fastest(self, question: Question, width: Fraction) -> Method | None:
        return GENERAL.fastest(self.taken(question), width) if clock_is_tried(question) else None

    @staticmethod
    def taken(question: Question) -> Question:
        """Of large plants the first shape of the schedule only."""
        return question if size(question.plant) <= _WHOLE else question.with_effort(0)


@dataclass(frozen=True)
class QuickRung(One):
    """A rung whose proofs are quick, and hold for all shorter periods too: its searches go closer to their end, and
    where two far shorter periods have none either nothing is looked for."""

    def longest(self, question: Question, share: float = 0.0) -> Method | None:
        shorter = (search.short(part * float(question.law.T_max), 6) for part in (1.0, *_SHORTER))
        if all(self.propose(question.at(T)) is None for T in shorter):
            return None
        return longest_at(self, question, share, quick=True)


@dataclass(frozen=True)
class Headline:
    """A rung asked with the effort of the headline."""

    rung: Rung

    @property
    def name(self) -> str:
        return self.rung.name

    def propose(self, question: Question) -> Method | None:
        return self.rung.propose(headline(question))

    def longest(self, question: Question, share: float = 0.0) -> Method | None:
        return self.rung.longest(headline(question), share)

    def fastest(self, question: Question, width: Fraction) -> Method | None:
        return self.rung.fastest(headline(question), width)


WIRTINGER, REPAIRED, THEOREM_1, CLOCK = (
    QuickRung(Wirtinger),
    QuickRung(Repaired),
    QuickRung(PrintedTheorem1),
    ClockRung(),
)


def rungs(family: LpvZeroOrderHold, question: Question) -> Sequence[Rung]:
    """The certificates to look for. The printed Theorem 1 is none: its proof has a gap."""
    if too_many_corners(question.plant) is not None:
        return ()
    if question.inclusion.outputs:
        return (Headline(CLOCK),)
    known: dict[str, Rung] = {"wirtinger": WIRTINGER, "clock": Headline(CLOCK), "repaired": REPAIRED}
    if family.method in known:
        return (known[family.method],)
    return [rung for name, rung in known.items() if name != "repaired" or is_class_16(question.plant)]


def too_many_corners(plant: Plant) -> str | None:
    corners = 2 ** len(plant.slopes.quantities)
    if corners <= MOST_CORNERS:
        return None
    return f"the slope box has {corners} corners, at most {MOST_CORNERS} are taken: declare fewer slopes that vary"


def beyond(family: LpvZeroOrderHold, question: Question, own: Sequence[Method]) -> Beyond:
    """(P, Y) that take the printed theorem furthest; period against rate; laws that no gain survives."""
    certificates: list[Certificate] = []
    if own and family.method == "theorem_1" and family.printed is None:
        printed = THEOREM_1.longest(question)
        certificates += [printed.certificate()] if printed is not None else []
    proved = max((float(method.law.T_max) for method in own), default=None)
    if question.inclusion.outputs:
        return Beyond(certificates)
    curve = Curve()
    # The curve of period against rate belongs to a search; effort 0 is for a quick answer, and under noise the front is
    # one of errors.
    if own and family.gain is None and question.effort > 0 and not question.plant.is_perturbed:
        curve = gain_curve(headline(question), own)
        certificates += [c for c in curve.longest if proved is None or float(c.sampling.T_max) > proved]
    certificates += [method.certificate() for method in _hopeless(question, proved)]
    return Beyond(certificates, curve.document(), curve.front)


def _hopeless(question: Question, proved: float | None) -> list[Method]:
    """Laws that no gain survives: the question's own where nothing is proved, and the smallest found above what is."""
    own = NoGain.propose(question) if proved is None else None
    if own is None:
        start = float(question.law.T_max) if proved is None else proved
        met = search.smallest(lambda T: NoGain.propose(question.at(T)), start, _GROWTH, _WIDTH, span=_SPAN)
        return [met[1]] if met is not None else []
    low, high = float(question.law.T_max) / 100, question.law.T_max
    nearer = search.smallest(lambda T: NoGain.propose(question.at(T)), low, float(high) / low, _WIDTH)
    return [own, nearer[1]] if nearer is not None and nearer[1].law != own.law else [own]
