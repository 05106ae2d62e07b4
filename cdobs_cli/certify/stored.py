"""The certificates of a stored design, read and proved again: each once for all that is asked of a design in turn."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import field
from functools import cached_property
from typing import ClassVar, Protocol

from cdobs_cli.certify.methods.base import Method, Proof, Question, Stored, read
from cdobs_cli.certify.methods.named import COMMON, Known
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass


class Reader(Protocol):
    """What is asked of a family's card."""

    letter: ClassVar[str]

    def methods(self) -> tuple[Known, ...]:
        """The methods whose certificates its designs may hold."""


@dataclass(frozen=True)
class Judged:
    """A stored certificate, what is proved of it, and the gain it is about where that is not the design's."""

    method: Method
    proof: Proof
    gain: Mapping[str, ExactMatrix] | None

    @property
    def own(self) -> bool:
        return self.gain is None

    @property
    def T(self) -> Exact:
        return self.method.law.period


@dataclass(frozen=True)
class _Last:
    """The design that was asked about last, with what is proved of its certificates by now, by their places."""

    card: Reader
    plant: Plant
    design: Design
    gain: Mapping[str, ExactMatrix]
    proofs: dict[int, Proof] = field(default_factory=dict)

    @cached_property
    def stored(self) -> list[Stored | None]:
        methods = (*self.card.methods(), *COMMON)
        return [read(one, methods, (self.card.letter,)) for one in self.design.certificates]

    def is_of(self, card: Reader, plant: Plant, design: Design, question: Question) -> bool:
        """Whether it is about these very objects, which nothing changes."""
        same = self.card is card and self.plant is plant and self.design is design
        return same and self.gain == question.inclusion.gain


_last: list[_Last] = []


def judged(
    card: Reader, plant: Plant, design: Design, question: Question, wanted: Callable[[Method], bool] = lambda _: True
) -> list[Judged]:
    """The certificates that can be read and are wanted, each proved again.

    plant: as it came with the design. question: about it under the design's law, of the gain; a proof hangs on nothing
    else of it.
    """
    last, items = next(iter(_last), None), []
    if last is None or not last.is_of(card, plant, design, question):
        last = _Last(card, plant, design, question.inclusion.gain)
        _last[:] = [last]  # for whoever asks next; another thread may put its own there at any time
    for place, stored in enumerate(last.stored):
        if stored is None or not wanted(stored.method):
            continue
        gain = stored.gain
        if gain is not None and gain[card.letter].shape != question.plant.gain_shape:
            continue
        if place not in last.proofs:
            last.proofs[place] = stored.method.prove(question if gain is None else question.with_gain(gain))
        items.append(Judged(stored.method, last.proofs[place], gain))
    return items
