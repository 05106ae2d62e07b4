"""Dataclasses that are finished when they are first used are those of the standard library."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from dataclasses import FrozenInstanceError, field
from typing import Any

import pytest

from cdobs_cli.records import dataclass


def classes(decorator: Any) -> tuple[Any, ...]:
    """A frozen class, one below it, and one that changes; made anew, so that nobody has used them."""

    @decorator(frozen=True)
    class Frozen:
        a: int
        b: tuple[int, ...] = (1, 2)
        beside: dict[str, int] = field(default_factory=dict, compare=False, repr=False)

    @decorator(frozen=True)
    class Below(Frozen):
        c: str = "c"

    @decorator
    class Changing:
        a: int

        def __repr__(self) -> str:
            return "its own"

    return Frozen, Below, Changing


OURS, THEIRS = classes(dataclass), classes(dataclasses.dataclass)


@pytest.mark.parametrize(
    "make", [lambda kinds: kinds[0](3), lambda kinds: kinds[1](3, c="d"), lambda kinds: kinds[2](3)]
)
def test_instances_are_those_of_the_standard_library(make: Any) -> None:
    ours, theirs = make(classes(dataclass)), make(THEIRS)
    assert repr(ours).replace("classes.<locals>.", "") == repr(theirs).replace("classes.<locals>.", "")
    names = [one.name for one in dataclasses.fields(ours)]
    assert names == [one.name for one in dataclasses.fields(theirs)]
    assert dataclasses.replace(ours, a=4) != ours == copy.copy(ours) and ours.__eq__(3) is NotImplemented
    assert type(ours).__match_args__ == type(theirs).__match_args__


def test_a_frozen_class_has_a_hash_and_stays_as_it_is() -> None:
    Frozen, Below, Changing = classes(dataclass)
    assert hash(Below(1)) == hash(THEIRS[1](1)) and Frozen(1) != Below(1)
    with pytest.raises(FrozenInstanceError):
        Frozen(1).a = 2
    with pytest.raises(TypeError):
        hash(Changing(1))
    changing = Changing(1)
    changing.a = 2
    assert changing == Changing(2)


@pytest.mark.parametrize(
    "use",
    [
        lambda kind, one, other: one == other and hash(one) == hash(other),
        lambda kind, one, other: repr(one).endswith("(a=1, b=(1, 2))"),
        lambda kind, one, other: dataclasses.replace(one, a=2).a == 2,
        lambda kind, one, other: dataclasses.is_dataclass(kind) and kind.__match_args__[0] == "a",
        lambda kind, one, other: dataclasses.make_dataclass("C", [], bases=(kind,), frozen=True)(1).b == (1, 2),
    ],
)
def test_a_class_is_finished_by_whatever_comes_first(use: Any) -> None:
    kind = classes(dataclass)[0]
    one, other = (kind.__new__(kind) for _ in range(2))  # as they come from another process
    for each in (one, other):
        vars(each).update(a=1, b=(1, 2), beside={})
    assert use(kind, one, other)


def test_what_comes_from_another_process_cannot_be_changed() -> None:
    kind = classes(dataclass)[0]
    one = kind.__new__(kind)
    with pytest.raises(FrozenInstanceError):
        one.a = 2


@dataclass(frozen=True)
class Sent:
    """Pickled by its place in the module."""

    a: int


def test_instances_can_be_sent() -> None:
    assert pickle.loads(pickle.dumps(Sent(1))) == Sent(1)


def test_own_methods_stay() -> None:
    @dataclass(frozen=True)
    class Own:
        a: int

        def __eq__(self, other: object) -> bool:
            return True

    assert Own(1) == Own(2) and hash(Own(1)) == hash((1,))
    assert repr(OURS[2](1)) == "its own"
