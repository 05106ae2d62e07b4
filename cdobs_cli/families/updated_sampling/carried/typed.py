"""What a spec types of the law, and the law of a stored design."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

from cdobs_cli.exact.numbers import Exact, decimal_text
from cdobs_cli.families.updated_sampling.carried.law import LAW, MATRICES, NUMBERS, Law

if TYPE_CHECKING:
    from cdobs_cli.design import Design
    from cdobs_cli.families.updated_sampling import UpdatedSampling


def stored_law(family: UpdatedSampling, design: Design) -> Law:
    """The law of a stored design; what is typed of it is that of the spec.

    Raises: KeyError, TypeError, ValueError, ExpressionError where there is none, or another one.
    """
    law = Law.read(design.details[LAW])
    for name, value in typed_parts(family).items():
        if getattr(law, name) != value:
            raise ValueError(f"its {name} is not that of the spec")
    return law


def typed_parts(family: UpdatedSampling) -> dict[str, Any]:
    """What the spec says of the law itself, by the law's names."""
    block = family.law
    parts: dict[str, Any] = {}
    if block is not None:
        parts = {name: one for name in (*MATRICES, *NUMBERS) if (one := getattr(block, name)) is not None}
    if family.budget is not None:
        parts["T_min"] = per_budget(family.budget)
    return {
        **parts,
        "kappa": family.rule.kappa if family.rule else None,
        "reset": family.reset,
        "one": family.read == "one",
    }


def per_budget(budget: Exact) -> Exact:
    """1 / budget, rounded up: never more measurements per time than that."""
    rational = budget.rational
    if rational is None:
        return Exact(decimal_text(Fraction(1 / float(budget)) * (1 + Fraction(1, 10**9)), 12))
    return Exact(1 / rational)


def is_whole(family: UpdatedSampling) -> bool:
    """Whether the spec types the law itself: F, split, sigma and T_min."""
    return set(typed_parts(family)) >= {"F", "split", "sigma", "T_min"}
