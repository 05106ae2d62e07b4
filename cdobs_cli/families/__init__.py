"""The registry of families: one name in the union for each. Nothing else lists them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from cdobs_cli.families.base import Family
from cdobs_cli.families.reachability import Reachability

FAMILIES: dict[str, type[Family]] = {
    "reachability": Reachability,
}

# `Union[A, B, ..]` of every class above, told apart by its `family` key.
ObserverFamily = Annotated[
    Reachability,
    Field(discriminator="family"),
]
