"""The slopes that a carried certificate is for: of each entry |V_ij| <= c_ij(t) <= cbar_ij, c_ij known online."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction

from cdobs_cli.exact.expression import Expression, Number, call
from cdobs_cli.families.updated_sampling.lipschitz import Rate, magnitudes
from cdobs_cli.plant import Entry, Plant


def largest_slopes(plant: Plant, rate: Rate) -> dict[Entry, Fraction] | None:
    """cbar_ij: the least of what the slope itself is bounded by and of the largest c; None where c has no bound. An
    entry that is 0 is left out."""
    bounds = magnitudes(plant)
    if bounds is None or rate.largest is None or rate.largest.rational is None:
        return None
    largest = rate.largest.rational
    return {entry: min(bound, largest) for entry, bound in bounds.items() if min(bound, largest) > 0}


def shares(largest: Mapping[Entry, Fraction], rate: Rate, c: Expression) -> dict[Entry, Expression]:
    """q_ij = min(c, cbar_ij) / cbar_ij, in [0, 1]: c, which is that of the rate, is at most its largest."""
    most = None if rate.largest is None else rate.largest.rational
    return {
        entry: c / Number(bound) if most == bound else call("min", Number(1), c / Number(bound))
        for entry, bound in largest.items()
    }
