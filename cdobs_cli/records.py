"""Dataclasses that are finished when they are first used: most of those that a command loads it never makes one of, and
the methods of one take longer to write than its module takes to load.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence, Set
from functools import partial
from operator import attrgetter
from reprlib import recursive_repr
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
            dataclasses.dataclass(**{**options, "eq": False, "repr": False})(kind)
            _give(kind, frozenset(pending), options)


def _give(kind: Any, pending: Set[str], options: Mapping[str, Any]) -> None:
    """What the standard library compiles for each class anew: how it compares, its hash and how it is shown."""
    own = dataclasses.fields(kind)
    compared = _values([one.name for one in own if one.compare])
    hashed = _values([one.name for one in own if (one.compare if one.hash is None else one.hash)])
    shown = [one.name for one in own if one.repr]

    def equals(self: Any, other: Any) -> Any:
        return compared(self) == compared(other) if other.__class__ is self.__class__ else NotImplemented

    def hash_of(self: Any) -> int:
        return hash(hashed(self))

    @recursive_repr()
    def text(self: Any) -> str:
        return f"{type(self).__qualname__}({', '.join(f'{name}={getattr(self, name)!r}' for name in shown)})"

    given: dict[str, Any] = {"__repr__": text} if options.get("repr", True) else {}
    if options.get("eq", True):
        given |= {"__eq__": equals, "__hash__": hash_of if options.get("frozen") else None}
    for name in given.keys() & pending:
        setattr(kind, name, given[name])


def _values(names: Sequence[str]) -> Callable[[Any], tuple[Any, ...]]:
    """The attributes of these names, as a tuple."""
    if len(names) > 1:
        return attrgetter(*names)
    return lambda one: tuple(getattr(one, name) for name in names)


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
