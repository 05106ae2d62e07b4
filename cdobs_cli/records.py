"""Dataclasses that are finished when they are first used: most of those that a command loads it never makes one of, and
the methods of one take longer to write than its module takes to load.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import partial
from threading import RLock
from typing import TYPE_CHECKING, Any

__all__ = ["dataclass"]

# What the standard library gives a dataclass.
_GIVEN = (
    "__init__", "__repr__", "__eq__", "__hash__", "__setattr__", "__delattr__", "__match_args__",
    "__dataclass_fields__", "__dataclass_params__",
)  # fmt: skip
_LOCK = RLock()


class _Pending:
    """An attribute of a class that is not finished. Who asks for it, or for that of a subclass, has it finished."""

    def __init__(self, kind: type, options: Mapping[str, Any], name: str) -> None:
        self.kind, self.options, self.name = kind, options, name

    def __get__(self, instance: object, owner: type) -> Any:
        _finish(self.kind, self.options)
        return getattr(owner if instance is None else instance, self.name)


def _finish(kind: type, options: Mapping[str, Any]) -> None:
    with _LOCK:
        pending = [name for name, value in vars(kind).items() if isinstance(value, _Pending)]
        for name in pending:
            delattr(kind, name)
        if pending:
            dataclasses.dataclass(**options)(kind)


def _begun(kind: type, **options: Any) -> type:
    """The class as the decorator leaves it; what it defines itself stays its own."""
    own = vars(kind)
    for name in _GIVEN:
        # Where a class defines how it compares, Python says that it has no hash; the decorator may give it one.
        if name not in own or (name == "__hash__" and own[name] is None and "__eq__" in own):
            setattr(kind, name, _Pending(kind, options, name))
    return kind


if TYPE_CHECKING:
    from dataclasses import dataclass
else:

    def dataclass(kind=None, /, **options):
        """As in the standard library; a class with slots, which is another class, is finished at once."""
        if kind is None:
            return partial(dataclass, **options)
        return dataclasses.dataclass(**options)(kind) if options.get("slots") else _begun(kind, **options)
