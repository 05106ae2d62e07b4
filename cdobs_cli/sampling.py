"""The sampling law: when measurements come, which laws it holds, and how it is put in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from cdobs_cli.exact.numbers import EXACT_ZERO, Exact

SamplingKind = Literal["periodic", "aperiodic", "updated"]


@dataclass(frozen=True)
class SamplingLaw:
    """When measurements come: t_(k+1) - t_k in [T_min, T_max] (time units of the plant).

    periodic: T_min = T_max; aperiodic: 0 <= T_min < T_max; updated: the observer chooses, both are 0.
    """

    kind: SamplingKind
    T_min: Exact = EXACT_ZERO
    T_max: Exact = EXACT_ZERO

    @staticmethod
    def periodic(period: Exact) -> SamplingLaw:
        return SamplingLaw("periodic", period, period)

    def with_period(self, T: Exact) -> SamplingLaw:
        """The law with its period (or its largest period) replaced; a smaller T_max takes T_min along."""
        if self.kind == "periodic":
            return SamplingLaw.periodic(T)
        T_min = self.T_min if float(self.T_min) <= float(T) else T
        return SamplingLaw(self.kind, T_min, T)

    @property
    def is_periodic(self) -> bool:
        """Whether all periods are one number."""
        return not self.is_updated and self.T_min == self.T_max

    @property
    def is_updated(self) -> bool:
        """Whether the observer chooses its instants."""
        return self.kind == "updated"

    @property
    def from_zero(self) -> bool:
        """Whether periods may be as short as one likes."""
        return self.kind == "aperiodic" and self.T_min.sign() == 0

    @property
    def is_bounded(self) -> bool:
        """Whether the periods are known to lie in an interval [T_min, T_max] with T_max > 0."""
        return not self.is_updated and self.T_max.sign() == 1 and self.T_min.sign() in (0, 1)

    def contains(self, other: SamplingLaw) -> bool:
        """Whether every sequence of periods of the other law is one of this law."""
        return self.T_min.is_at_most(other.T_min) and other.T_max.is_at_most(self.T_max)

    @property
    def symbols(self) -> str:
        """`T_k = 0.6`, `T_k in [0, 5]`."""
        return f"T_k = {self.T_max}" if self.is_periodic else f"T_k in [{self.T_min}, {self.T_max}]"

    @property
    def words(self) -> str:
        """Behind "sampling": `every 0.6`, `at periods in [0, 5]`."""
        return f"every {self.T_max}" if self.is_periodic else f"at periods in [{self.T_min}, {self.T_max}]"

    @property
    def open_end(self) -> str:
        """The law without its largest period: `constant periods`, `periods from 0.1`."""
        return "constant periods" if self.is_periodic else f"periods from {self.T_min}"

    def text(self, unit: str) -> str:
        """For people, in a unit of time: `every 0.6 s`, `at intervals anywhere in [0, 5] s`."""
        if self.is_updated:
            return "at instants that the observer chooses"
        return (
            f"every {self.T_max} {unit}"
            if self.is_periodic
            else f"at intervals anywhere in [{self.T_min}, {self.T_max}] {unit}"
        )

    def document(self) -> dict[str, Any]:
        """As in a spec: {period}, {min_period, max_period} or {updated}."""
        if self.kind == "periodic":
            return {"period": str(self.T_max)}
        if self.kind == "aperiodic":
            return {"min_period": str(self.T_min), "max_period": str(self.T_max)}
        return {"updated": True}

    @staticmethod
    def from_document(document: dict[str, Any]) -> SamplingLaw:
        """Raises: TypeError, ValueError on anything `document` did not write."""
        match document:
            case {"updated": True, **rest} if not rest:
                return SamplingLaw("updated")
            case {"period": str(period), **rest} if not rest:
                law = SamplingLaw.periodic(Exact(period))
            case {"min_period": str(shortest), "max_period": str(longest), **rest} if not rest:
                law = SamplingLaw("aperiodic", Exact(shortest), Exact(longest))
            case _:
                raise ValueError("not a sampling law")
        if law.T_max.sign() != 1 or law.T_min.sign() == -1 or (law.T_max - law.T_min).sign() == -1:
            raise ValueError("periods that no sampling law has")
        return law
