"""`family: auto`, or no observer block: the families that take plant and law, each with what was asked of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, get_args

from pydantic import Field

from cdobs_cli.errors import Problem
from cdobs_cli.families import FAMILIES, Family
from cdobs_cli.families.constant_gain import ERROR_WORDS, RATE_WORDS, WEIGHT_WORDS, Objective
from cdobs_cli.fields import NonNegativeNumber, PositiveNumber
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass
from cdobs_cli.run import SimulationPlan
from cdobs_cli.spec.block import Block

AUTO = "auto"
LONGEST_GOT = 40  # characters of what a family does not take, in a line


class AutoBlock(Block):
    """`observer: {family: auto, ..}`; without an objective each family has its own first one, but a rate to be kept
    asks for the longest period."""

    family: Literal["auto"] = "auto"
    objective: Objective | None = Field(
        default=None, description="What the gain is found for; each family has its own first one where left out."
    )
    rate_at_least: NonNegativeNumber | None = Field(default=None, description=RATE_WORDS)
    error_at_most: dict[str, PositiveNumber] | None = Field(default=None, description=ERROR_WORDS)
    weights: dict[str, NonNegativeNumber] | None = Field(default=None, description=WEIGHT_WORDS)

    @property
    def options(self) -> dict[str, Any]:
        """What was typed, for a family's card."""
        objective = "max_period" if self.objective is None and self.rate_at_least is not None else self.objective
        typed = {"objective": objective} | {
            name: getattr(self, name) for name in ("rate_at_least", "error_at_most", "weights")
        }
        return {name: value for name, value in typed.items() if value is not None}


@dataclass(frozen=True)
class Choice:
    """What the observer is chosen from.

    cards: of the families that take plant, law and options, by name, in the order of the registry; refused: why the
    others do not, by name.
    """

    block: AutoBlock
    cards: Mapping[str, Family]
    refused: Mapping[str, str]

    @staticmethod
    def of(block: AutoBlock, plant: Plant, plan: SimulationPlan | None) -> Choice:
        cards: dict[str, Family] = {}
        refused: dict[str, str] = {}
        for name, family in FAMILIES.items():
            reason = _missing(block, family)
            if reason is None:
                card = family.model_validate(block.options)
                reason = next((_told(problem) for problem in card.mistakes(plant, plan)), None)
            if reason is None:
                cards[name] = card.resolved(plant, None if plan is None else float(plan.horizon))
            else:
                refused[name] = reason
        return Choice(block, cards, refused)

    @property
    def problem(self) -> Problem | None:
        """That no family is left."""
        if self.cards:
            return None
        told = "; ".join(f"{name}: {why}" for name, why in self.refused.items())
        return Problem(("observer",), "no family takes this plant and its sampling", hint=told)


def _missing(block: AutoBlock, family: type[Family]) -> str | None:
    """What was asked that the family does not have."""
    for name, value in block.options.items():
        field = family.model_fields.get(name)
        if field is None:
            return f"it has no {name}"
        if name == "objective" and value not in get_args(field.annotation):
            return f"it has no objective {value}"
    return None


def _told(problem: Problem) -> str:
    got = f" ({problem.got})" if problem.got is not None and len(problem.got) <= LONGEST_GOT else ""
    return f"{problem.path}: {problem.what}{got}"
