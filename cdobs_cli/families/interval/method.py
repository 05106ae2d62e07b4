"""The certificates of this family: matrices of exact numbers, one for the design's law and one for a longer period."""

from __future__ import annotations

from abc import ABC
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from fractions import Fraction
from typing import Any, Self, TypeVar

from cdobs_cli.arrays import Array
from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import search
from cdobs_cli.certify.lmi import Program
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.records import dataclass

P = TypeVar("P", bound="Part")
Gain = Mapping[str, ExactMatrix]

SOURCE = "Efimov2016"
DIGITS = 12  # of the entries of certificates


@dataclass(frozen=True)
class Part(Method, ABC):
    """A certificate for a part of what is claimed."""

    source = SOURCE

    @classmethod
    def longest(cls, question: Question) -> Self | None:
        return None

    @classmethod
    def stored(cls, question: Question) -> Sequence[Part]:
        """What is worth storing for a design: the certificate of its law, and that of the longest period found."""
        certificates = [part for part in (cls.propose(question), cls.longest(question)) if part is not None]
        return list({part.law: part for part in certificates}.values())

    def proved(self, question: Question) -> Self | None:
        """The certificate where it is proved."""
        return self if self.prove(question).holds else None

    def certificate(self, gain: Gain | None = None) -> Certificate:
        data = {one.name: _texts(getattr(self, one.name)) for one in fields(self) if one.name != "law"}
        return Certificate(self.name, self.law, {name: value for name, value in data.items() if value is not None})


def _texts(value: Any) -> Any:
    if isinstance(value, ExactMatrix):
        return value.texts()
    if isinstance(value, tuple):
        return [_texts(one) for one in value]
    if isinstance(value, dict):
        return {name: _texts(one) for name, one in value.items()}
    return None if value is None else str(value)


def between(prove: Callable[[Exact], P | None], low: Exact, high: Exact, width: Fraction) -> P | None:
    """The certificate of the longest period found in [low, high]."""
    proof = search.between(prove, low, high, width)
    return None if proof is None else proof[1]


def largest_margin(program: Program) -> Mapping[str, Array] | None:
    """The unknowns with the largest t; None where that is not positive."""
    program.maximise(lambda x: x["t"])
    values = program.solve().values
    return values if values["t"][0, 0] > 0 else None
