"""Measurements that arrive late with exact stamps: how late those of each sensor, and that in words."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from cdobs_cli.exact.numbers import Exact


@dataclass(frozen=True)
class Delay:
    """What a sensor measures at t_k arrives at t_k + d with d in [lower, upper], in any order.

    name: the sensor's, empty where there is one alone. outputs: the numbers of what it measures.
    """

    name: str
    outputs: tuple[int, ...]
    lower: Exact
    upper: Exact

    @property
    def is_late(self) -> bool:
        """Whether a sample may arrive after it is taken."""
        return self.upper.sign() != 0

    @property
    def is_constant(self) -> bool:
        return (self.upper - self.lower).sign() == 0

    @property
    def field(self) -> tuple[str, ...]:
        """Where it is typed."""
        return ("measurement", "sensors", self.name, "delay") if self.name else ("measurement", "delay")

    def words(self, unit: str = "") -> str:
        """Behind "arrives": `at once`, `20 min after it is taken`, `0 to 0.05 s after it is taken`."""
        if not self.is_late:
            return "at once"
        after = f"{unit} after it is taken".strip()
        return f"{self.upper} {after}" if self.is_constant else f"{self.lower} to {self.upper} {after}"


def longest(delays: Iterable[Delay]) -> Exact:
    """The largest delay of any sensor."""
    return max((one.upper for one in delays), key=float)


def arrival_words(delays: Iterable[Delay], unit: str = "") -> str:
    """Of all sensors: `each sample arrives 0.05 s after it is taken`, `of temperature each sample arrives at once, of
    laboratory 20 min after it is taken`; empty where nothing is late."""
    told = [(one.name, one.words(unit)) for one in delays]
    if not told:
        return ""
    (name, first), *others = told
    head = f"of {name} each sample arrives {first}" if name else f"each sample arrives {first}"
    return ", ".join((head, *(f"of {name} {words}" for name, words in others)))
