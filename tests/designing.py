"""A design as `cdobs synthesize` makes it of a plant, by a card alone."""

from __future__ import annotations

from typing import Any


def designed(card: Any, plant: Any, effort: int) -> Any:
    """With what is worth knowing of it."""
    return card.finished(plant, card.synthesize(plant, effort), effort)
