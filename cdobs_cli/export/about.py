"""What every exported file says of itself: whose observer it is, what is proved of it, and how it is used."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from textwrap import wrap

from cdobs_cli import __version__
from cdobs_cli.export.portable import Portable
from cdobs_cli.labels import Labels
from cdobs_cli.printable import printable
from cdobs_cli.records import dataclass

_WIDTH = 100
NOT_PROVED = "NOT PROVED: nothing guarantees this observer as it stands."


@dataclass(frozen=True)
class About:
    """verdict, and `told`, the sentences of the check; digests: of design and check. accuracy: how far the estimate was
    from the simulator's over the vectors, in parts of its size; None where nothing was compared."""

    title: str
    source: str
    verdict: str
    told: tuple[str, ...]
    digests: tuple[tuple[str, str], ...]
    law: str
    labels: Labels
    accuracy: float | None = None
    step: float = 0.0

    def with_step(self, step: float, accuracy: float | None) -> About:
        """With the longest step of the integration, and what it comes to."""
        return replace(self, step=step, accuracy=accuracy)

    def lines(self, portable: Portable, usage: tuple[str, ...]) -> list[str]:
        """Plain lines, for a comment of any language."""
        return [printable(line) for paragraph in self._paragraphs(portable, usage) for line in _wrapped(paragraph)]

    def _paragraphs(self, portable: Portable, usage: tuple[str, ...]) -> Iterator[str]:
        yield f"{portable.name}: {self.title}"
        yield f"Exported by cdobs {__version__} from {self.source}; do not edit, export again."
        yield ""
        yield f"Verdict: {self.verdict}." if self.verdict == "proved" else f"Verdict: {self.verdict}. {NOT_PROVED}"
        yield from self.told
        for name, value in self.digests:
            yield f"sha256 of {name}: {value}"
        yield ""
        yield f"Samples: {self.law}."
        yield f"Time in {self.labels.time}. {self._units(portable)}"
        yield self._integration()
        yield ""
        yield from usage

    def _units(self, portable: Portable) -> str:
        names = [f"{name} ({self.labels.states[name]})" if name in self.labels.states else name for name in
                 portable.original or portable.plant_states]  # fmt: skip
        told = f"States: {', '.join(names)}."
        if portable.original:
            told += f" The estimate is in the coordinates {', '.join(portable.plant_states)}."
        return f"{told} Inputs: {', '.join(portable.inputs)}." if portable.inputs else told

    def _integration(self) -> str:
        told = f"Between samples: Dormand-Prince of order 8, fixed steps of at most {self.step!r} {self.labels.time}"
        if self.accuracy is None:
            return f"{told}; not compared with a simulation, as the spec has none."
        return f"{told}; in double precision within {self.accuracy:.1g} of the simulator's estimate (part of its size)."


def _wrapped(paragraph: str) -> list[str]:
    return wrap(paragraph, _WIDTH, break_long_words=False, break_on_hyphens=False) or [""]
