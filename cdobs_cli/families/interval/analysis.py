"""One plant with one design, and what is decided of it: read by every group of claims."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, TypeVar

from flint import arb

from cdobs_cli.certificate import Bound, Certificate, Claim, Status, Witness
from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.interval.boundedness import prove_hurwitz
from cdobs_cli.families.interval.cone import Cone, ErrorSystem
from cdobs_cli.families.interval.intersect import measured_rows
from cdobs_cli.families.interval.positivity import PositivityLimit, positivity_limit
from cdobs_cli.families.interval.sampled_width import width_contracts
from cdobs_cli.families.interval.theorems import (
    Coordinates,
    assumption_3,
    coordinates,
    error_flow,
    error_held,
    width_matrix,
)
from cdobs_cli.plant import Box, Plant
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from cdobs_cli.families.interval import Interval

T_ = TypeVar("T_")
SOURCE = "Efimov2016"


@dataclass
class Analysis:
    """One plant with one design: claims and bounds as they are decided.

    Everything is read from the typed plant, the printed gain and the stored certificates.
    """

    family: Interval
    plant: Plant
    design: Design
    effort: int
    claims: list[Claim] = field(default_factory=list)
    bounds: dict[str, Bound] = field(default_factory=dict)
    reasons: dict[str, str] = field(default_factory=dict)

    @property
    def law(self) -> SamplingLaw:
        return self.design.sampling

    @cached_property
    def T(self) -> arb:
        """The largest period of the law."""
        return self.law.T_max.ball()

    @cached_property
    def z(self) -> Coordinates[Matrix]:
        S, L = self.design.gain["S"].balls(), self.design.gain["L"].balls()
        return coordinates(self.plant.A.balls(), self.plant.C.balls(), S, S.inverse(), L)

    @cached_property
    def Mtot(self) -> Matrix:
        return width_matrix(self.z.Q0, self.z.Q1)

    @cached_property
    def limit(self) -> PositivityLimit:
        return positivity_limit(error_flow(self.z.Q0), error_held(self.z.Q1), self.effort)

    @property
    def ordered(self) -> bool:
        """Whether E(s) >= 0 is proved up to the law's largest period: errors in the orthant stay there."""
        return self.limit.holds_until(self.T)

    @property
    def cuts(self) -> bool:
        """Whether measured rows of z are intersected with y at samples."""
        return self.family.tighten == "intersect"

    @property
    def is_hull(self) -> bool:
        """Whether the observer run is the hull predictor."""
        return self.family.tighten == "hull"

    @cached_property
    def errors(self) -> ErrorSystem:
        rows = measured_rows(self.plant.C.balls(), self.z.S) if self.cuts else {}
        return ErrorSystem.of(self.z, *declared_widths(self.plant), tuple(rows))

    @cached_property
    def cone(self) -> Cone | None:
        """The stored cone of the law, where it is proved to hold the errors."""
        found = self.certificate("cone", lambda stored: Cone.from_document(stored.data))
        if found is None or found[0].sampling != self.law or not found[1].proves_enclosure(self.errors, self.law, self.effort):
            return None
        return found[1]

    @cached_property
    def cone_frontier(self) -> tuple[Cone, SamplingLaw] | None:
        """The stored cone of the law with a longer period, where it is proved to hold the errors."""
        found = self.certificate("cone_frontier", lambda stored: Cone.from_document(stored.data))
        if found is None or not same_law(found[0].sampling, self.law):
            return None
        return (found[1], found[0].sampling) if found[1].proves_enclosure(self.errors, found[0].sampling, self.effort) else None

    @cached_property
    def shrinks(self) -> bool:
        """Whether the errors in the cone of the law are proved to shrink."""
        return self.cone is not None and self.cone.proves_boundedness(self.errors, self.law, self.effort)

    @cached_property
    def w_star(self) -> Matrix | None:
        """The stored witness of a Hurwitz Mtot, where it is one."""
        stored = self.matrix("hurwitz", "w_star")
        if stored is None or stored[1].shape != (self.plant.n, 1):
            return None
        return stored[1]

    @cached_property
    def hurwitz_rate(self) -> arb | None:
        """The rate that w* proves; None where it proves none."""
        return None if self.w_star is None else prove_hurwitz(self.Mtot, self.w_star)

    @cached_property
    def contracts(self) -> bool:
        """Whether the map of the width from sample to sample is proved to contract in the norm of w*."""
        return self.w_star is not None and width_contracts(self.z.Q0, self.Mtot, self.w_star, self.law, self.effort)

    def enclosed_by_cones(self, *, bounded: bool = False) -> list[Exact]:
        """Largest periods for which a stored cone is proved to hold the errors, and they to stay bounded if asked."""
        found = [self.law.T_max] if self.cone is not None and (self.shrinks or not bounded) else []
        if self.cone_frontier is not None:
            cone, law = self.cone_frontier
            if not bounded or cone.proves_boundedness(self.errors, law, self.effort):
                found.append(law.T_max)
        return found

    @cached_property
    def structure(self) -> tuple[str, ...]:
        return assumption_3(self.z.Q1)

    @property
    def departs(self) -> bool:
        """Whether given S and L are not those of the observer (12): then nothing is claimed in its name. (The
        proofs themselves couple whatever signs Q1 has, and serve found gains as they are.)"""
        return bool(self.structure) and self.design.outcome == "given"

    @property
    def has_feedback(self) -> bool:
        return "K_lower" in self.design.gain

    def certificate(self, method: str, read: Callable[[Certificate], T_]) -> tuple[Certificate, T_] | None:
        """The stored certificate of a method, read; None where there is none or it cannot be read."""
        for stored in self.design.certificates:
            if stored.method == method:
                try:
                    return stored, read(stored)
                except (KeyError, ValueError, TypeError, IndexError, ExpressionError):
                    return None
        return None

    def matrix(self, method: str, name: str) -> tuple[SamplingLaw, Matrix] | None:
        found = self.certificate(method, lambda stored: ExactMatrix(stored.data[name]).balls())
        return None if found is None else (found[0].sampling, found[1])

    def say(
        self, identifier: str, kind: Any, status: Status, statement: str, source: str = SOURCE, *,
        margin: str | None = None, method: str | None = None, witness: Witness | None = None, reason: str | None = None,
    ) -> Status:  # fmt: skip
        """Note a claim; `reason` says in a clause why it is refuted."""
        if reason is not None:
            self.reasons[identifier] = reason
            statement = f"{statement}; {reason}"
        self.claims.append(Claim(identifier, kind, status, statement, source, margin=margin, method=method, witness=witness))
        return status


def at_most(one: Exact, other: Exact) -> bool:
    """Whether one <= other is certain."""
    return one == other or (other - one).sign() in (0, 1)


def same_law(one: SamplingLaw, other: SamplingLaw) -> bool:
    """Whether a law is the other with its period, or largest period, replaced."""
    return one == other.with_period(one.T_max)


def declared_widths(plant: Plant) -> tuple[Matrix, Matrix]:
    """upper - lower of disturbance and noise in balls, zeros where none is declared."""

    def widths(box: Box | None, size: int) -> Matrix:
        if box is None:
            return Matrix.zeros(size, 1)
        return ExactMatrix([[high - low] for low, high in zip(box.lower, box.upper, strict=True)]).balls()

    return widths(plant.disturbance, plant.n), widths(plant.noise, plant.p)


def matrices(a: Analysis) -> tuple[Matrix, Matrix, Matrix, Matrix, Matrix]:
    """A, C, S, S^-1 and L in balls."""
    return a.plant.A.balls(), a.plant.C.balls(), a.z.S, a.z.R, a.design.gain["L"].balls()
