"""The sampling law: when measurements come, which laws it holds, and how it is put in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from cdobs_cli.exact.numbers import EXACT_ZERO, Exact

MOST_LOST = 20  # samples in a row
SamplingKind = Literal["periodic", "aperiodic", "lossy", "random", "updated"]


@dataclass(frozen=True)
class SamplingLaw:
    """When measurements come: t_(k+1) - t_k in [T_min, T_max] (time units of the plant).

    periodic: T_min = T_max; aperiodic: 0 <= T_min < T_max; lossy: samples every T_min of which at most `lost` in a row
    are lost, so t_(k+1) - t_k is one of T_min, 2 T_min, .., T_max = (lost + 1) T_min; random: samples every T_min,
    which is T_max too, each lost with this probability, independently: then there is no longest time between two;
    updated: the observer chooses, both are 0.
    """

    kind: SamplingKind
    T_min: Exact = EXACT_ZERO
    T_max: Exact = EXACT_ZERO
    lost: int = 0
    probability: Exact = EXACT_ZERO

    @staticmethod
    def randomly(period: Exact, probability: Exact) -> SamplingLaw:
        """Every period, each sample lost with the probability, in [0, 1)."""
        if probability.sign() == 0:
            return SamplingLaw.periodic(period)
        return SamplingLaw("random", period, period, probability=probability)

    @staticmethod
    def periodic(period: Exact, lost: int = 0) -> SamplingLaw:
        """Every period; lost: so many in a row at most."""
        if not lost:
            return SamplingLaw("periodic", period, period)
        return SamplingLaw("lossy", period, period * Exact(lost + 1), lost)

    @property
    def period(self) -> Exact:
        """What `with_period` replaces: the period, lost samples or not, or the largest of an interval."""
        return self.T_min if self.is_lossy else self.T_max

    def with_period(self, T: Exact) -> SamplingLaw:
        """The law with its period (or its largest period) replaced; a smaller T_max takes T_min along."""
        if self.is_random:
            return SamplingLaw.randomly(T, self.probability)
        if self.kind in ("periodic", "lossy"):
            return SamplingLaw.periodic(T, self.lost)
        T_min = self.T_min if float(self.T_min) <= float(T) else T
        return SamplingLaw(self.kind, T_min, T)

    @property
    def is_periodic(self) -> bool:
        """Whether all periods are one number."""
        return not (self.is_updated or self.is_random) and self.T_min == self.T_max

    @property
    def is_lossy(self) -> bool:
        """Whether samples of a constant period may be lost."""
        return self.kind == "lossy"

    @property
    def is_random(self) -> bool:
        """Whether samples of a constant period are lost by chance."""
        return self.kind == "random"

    @property
    def multiples(self) -> tuple[Exact, ...]:
        """All that t_(k+1) - t_k may be, where these are finitely many: the period, of a lossy law its multiples."""
        if self.is_lossy:
            return tuple(self.T_min * Exact(k) for k in range(1, self.lost + 2))
        return (self.T_max,) if self.is_periodic else ()

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
        known = not (self.is_updated or self.is_random)
        return known and self.T_max.sign() == 1 and self.T_min.sign() in (0, 1)

    def contains(self, other: SamplingLaw) -> bool:
        """Whether every sequence of periods of the other law is certainly one of this law."""
        if self == other:
            return True
        if self.is_random or other.is_random:
            return False
        if self.is_lossy:
            return bool(other.multiples) and all(map(self.allows, other.multiples))
        return self.T_min.is_at_most(other.T_min) and other.T_max.is_at_most(self.T_max)

    def allows(self, gap: Exact) -> bool:
        """Whether t_(k+1) - t_k may certainly be so much for ever; of samples lost by chance nothing is certain."""
        if self.is_random:
            return False
        if self.is_lossy:
            return any(gap == one or (gap - one).sign() == 0 for one in self.multiples)
        return self.T_min.is_at_most(gap) and gap.is_at_most(self.T_max)

    @property
    def symbols(self) -> str:
        """`T_k = 0.6`, `T_k in [0, 5]`, `T_k in {0.6, .., 1.8}`."""
        if self.is_lossy:
            return f"T_k in {{{self.T_min}, .., {self.T_max}}}"
        if self.is_random:
            return f"T_k in {{{self.T_min}, 2 * {self.T_min}, ..}}"
        return f"T_k = {self.T_max}" if self.is_periodic else f"T_k in [{self.T_min}, {self.T_max}]"

    @property
    def words(self) -> str:
        """Behind "sampling": `every 0.6`, `at periods in [0, 5]`, `every 0.6, at most 2 in a row lost`."""
        if self.is_random:
            return f"every {self.T_min}, each sample lost with probability {self.probability}"
        if self.is_lossy:
            return f"every {self.T_min}, at most {self.lost} in a row lost"
        return f"every {self.T_max}" if self.is_periodic else f"at periods in [{self.T_min}, {self.T_max}]"

    @property
    def open_end(self) -> str:
        """The law without its period: `constant periods`, `periods from 0.1`."""
        if self.is_random:
            return f"constant periods, each sample lost with probability {self.probability}"
        if self.is_lossy:
            return f"constant periods, at most {self.lost} samples in a row lost"
        return "constant periods" if self.is_periodic else f"periods from {self.T_min}"

    def text(self, unit: str) -> str:
        """For people, in a unit of time: `every 0.6 s`, `at intervals anywhere in [0, 5] s`."""
        if self.is_updated:
            return "at instants that the observer chooses"
        if self.is_random:
            return f"every {self.T_min} {unit}, each lost with probability {self.probability}, independently"
        if self.is_lossy:
            return f"every {self.T_min} {unit}, of which at most {self.lost} in a row are lost"
        return (
            f"every {self.T_max} {unit}"
            if self.is_periodic
            else f"at intervals anywhere in [{self.T_min}, {self.T_max}] {unit}"
        )

    def document(self) -> dict[str, Any]:
        """As in a spec: {period}, {min_period, max_period} or {updated}; {period, lost} where samples may be lost."""
        if self.is_random:
            return {"period": str(self.T_min), "probability": str(self.probability)}
        if self.is_lossy:
            return {"period": str(self.T_min), "lost": self.lost}
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
            case {"period": str(period), "lost": lost, **rest} if not rest and _is_number_of_losses(lost):
                law = SamplingLaw.periodic(Exact(period), lost)
            case {"period": str(period), "probability": str(probability), **rest} if not rest:
                law = SamplingLaw.randomly(Exact(period), Exact(probability))
                if law.probability.sign() != 1 or (law.probability - Exact(1)).sign() != -1:
                    raise ValueError("not a sampling law")
            case {"min_period": str(shortest), "max_period": str(longest), **rest} if not rest:
                law = SamplingLaw("aperiodic", Exact(shortest), Exact(longest))
            case _:
                raise ValueError("not a sampling law")
        if law.T_max.sign() != 1 or law.T_min.sign() == -1 or (law.T_max - law.T_min).sign() == -1:
            raise ValueError("periods that no sampling law has")
        return law


def _is_number_of_losses(value: Any) -> bool:
    return type(value) is int and 0 < value <= MOST_LOST
