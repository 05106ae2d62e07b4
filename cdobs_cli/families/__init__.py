"""The registry of families: a line each. Nothing else lists them, and one is loaded when it is asked for.

The spec tells these classes apart by their `family` key.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping
from importlib import import_module
from typing import cast

from cdobs_cli.families.base import Family


class _Families(MutableMapping[str, type[Family]]):
    """The class of a family by the word behind `family:`; those not loaded yet as the name of the class in the package
    of that word."""

    def __init__(self, classes: Mapping[str, str]) -> None:
        self._classes: dict[str, str | type[Family]] = dict(classes)

    def __getitem__(self, name: str) -> type[Family]:
        kind = self._classes[name]
        if isinstance(kind, str):
            kind = getattr(import_module(f"{__name__}.{name}"), kind)
        self._classes[name] = family = cast("type[Family]", kind)
        return family

    def __setitem__(self, name: str, family: type[Family]) -> None:
        self._classes[name] = family

    def __delitem__(self, name: str) -> None:
        del self._classes[name]

    def __contains__(self, name: object) -> bool:
        return name in self._classes

    def __iter__(self) -> Iterator[str]:
        return iter(self._classes)

    def __len__(self) -> int:
        return len(self._classes)


FAMILIES = _Families(
    {
        "reachability": "Reachability",
        "lpv_zoh": "LpvZeroOrderHold",
        "interval": "Interval",
        "updated_sampling": "UpdatedSampling",
    }
)

__all__ = ["FAMILIES", "Family"]
