"""Measurements that arrive late with exact stamps: how late those of each sensor, and that in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from cdobs_cli.exact.numbers import Exact
from cdobs_cli.records import dataclass

ASSUMED_OF_LATE = (
    "Stamps are exact; samples may overtake one another, and delays do not depend on noise. On arrival the estimate is "
    "computed again from the stamp on."
)


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
        """Behind "arrive": `at once`, `20 min later`, `0 to 0.05 s later`."""
        if not self.is_late:
            return "at once"
        later = f"{unit} later".strip()
        return f"{self.upper} {later}" if self.is_constant else f"{self.lower} to {self.upper} {later}"


def arrival_words(delays: Iterable[Delay], unit: str = "") -> str:
    """Of all sensors: `samples arrive 0.05 s later`, `samples of thermometer arrive at once, of laboratory 20 min
    later`; empty where nothing is late."""
    told = [(one.name, one.words(unit)) for one in delays]
    if not told:
        return ""
    (name, first), *others = told
    head = f"samples of {name} arrive {first}" if name else f"samples arrive {first}"
    return ", ".join((head, *(f"of {name} {words}" for name, words in others)))


def longest(delays: Iterable[Delay]) -> Exact:
    """The largest delay of any sensor."""
    return max((one.upper for one in delays), key=float)


def put_in_words(delays: Sequence[Delay]) -> str:
    """Behind a sampling law: when its samples are there; empty where that is at once."""
    told = arrival_words(delays)
    return f", once every sample is there: {told}, and what is late is put in at its stamp" if told else ""
