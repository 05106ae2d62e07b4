"""The certificates of this family: matrices of exact numbers, one for the design's law and one for a longer period."""

from __future__ import annotations

from abc import ABC
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.exact.numbers import ExactMatrix

SOURCE = "Efimov2016"
DIGITS = 12  # of the entries of certificates


@dataclass(frozen=True)
class Part(Method, ABC):
    """A certificate for a part of what is claimed."""

    source = SOURCE

    @classmethod
    def stored(cls, question: Question) -> list[Self]:
        """What is worth storing for a design: the certificate of its law, and that of the longest period found."""
        certificates = [part for part in (cls.propose(question), cls.longest(question)) if part is not None]
        return list({part.law: part for part in certificates}.values())

    def certificate(self, gain: Mapping[str, ExactMatrix] | None = None) -> Certificate:
        data = {one.name: _texts(getattr(self, one.name)) for one in fields(self) if one.name != "law"}
        return Certificate(self.name, self.law, {name: value for name, value in data.items() if value is not None})


def _texts(value: Any) -> Any:
    if isinstance(value, ExactMatrix):
        return value.texts()
    if isinstance(value, tuple):
        return [_texts(one) for one in value]
    return None if value is None else str(value)
