"""The registry of families: a line each. Nothing else lists them; one is loaded when it is asked for.

The spec tells these classes apart by their `family` key.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from importlib import import_module

from cdobs_cli.families.base import Family


class _Families(Mapping[str, type[Family]]):
    """By the word behind `family:`, which is the name of its package, the class of a family."""

    def __init__(self, classes: Mapping[str, str]) -> None:
        self._classes = dict(classes)

    def __getitem__(self, name: str) -> type[Family]:
        kind = self._classes[name]  # KeyError comes first: nothing else is ever loaded
        family: type[Family] = getattr(import_module(f"{__name__}.{name}"), kind)
        return family

    def __contains__(self, name: object) -> bool:
        return name in self._classes

    def __iter__(self) -> Iterator[str]:
        return iter(self._classes)

    def __len__(self) -> int:
        return len(self._classes)


FAMILIES: Mapping[str, type[Family]] = _Families(
    {
        "reachability": "Reachability",
        "lpv_zoh": "LpvZeroOrderHold",
        "interval": "Interval",
        "updated_sampling": "UpdatedSampling",
    }
)

__all__ = ["FAMILIES", "Family"]
