"""Documents read back as nouns: exactly what was written, or an error."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import pytest

from cdobs_cli.certificate import Bound, Check, Claim, Witness
from cdobs_cli.codec import KEY, OPTIONAL, parse, read
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.sampling import SamplingLaw


@dataclass(frozen=True)
class Leaf:
    size: float
    kind: Literal["big", "small"] = field(metadata={KEY: "class"})
    count: int = 0
    is_green: bool = False
    note: str | None = None
    more: dict[str, Any] = field(default_factory=dict, metadata={OPTIONAL: True})


@dataclass(frozen=True)
class Tree:
    leaves: tuple[Leaf, ...]
    ends: Mapping[str, tuple[str, str]]
    gain: ExactMatrix
    law: SamplingLaw


LEAF = {"size": 1, "class": "big", "count": 2, "is_green": True, "note": None}
TREE = {"leaves": [LEAF], "ends": {"1.1": ["0", "1"]}, "gain": [["1", "1/3"]], "law": {"period": "0.5"}}


def test_what_was_written_is_read() -> None:
    tree = read(Tree, TREE)
    assert tree.leaves == (Leaf(1.0, "big", 2, True),)
    assert tree.ends == {"1.1": ("0", "1")}
    assert tree.gain == ExactMatrix([["1", "1/3"]])
    assert tree.law.document() == {"period": "0.5"}


@pytest.mark.parametrize(
    "change",
    [
        {"size": "1"}, {"size": True}, {"class": "huge"}, {"class": ["big"]}, {"count": 1.0}, {"count": True},
        {"is_green": 1},
        {"note": 3}, {"more": []}, {"kind": "big"}, {"unknown": 1},
    ],
)  # fmt: skip
def test_a_field_of_another_type_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises((TypeError, ValueError)):
        read(Leaf, LEAF | change)


@pytest.mark.parametrize("missing", LEAF)
def test_a_missing_key_is_refused(missing: str) -> None:
    with pytest.raises(KeyError):
        read(Leaf, {key: value for key, value in LEAF.items() if key != missing})


@pytest.mark.parametrize(
    "change",
    [
        {"leaves": "none"}, {"leaves": {}}, {"leaves": [[1]]}, {"ends": []}, {"ends": {"1.1": ["0"]}},
        {"ends": {"1.1": ["0", "1", "2"]}},
        {"gain": "1"}, {"gain": ["12"]}, {"gain": []}, {"gain": [["1"], ["1", "2"]]}, {"gain": [[1]]},
        {"gain": [["x"]]}, {"law": []},
        {"law": {"period": 0.5}}, {"law": {"period": "-1"}}, {"law": {"period": "1", "min_period": "0"}},
        {"law": {"updated": 1}},
        {"law": {"min_period": "2", "max_period": "1"}},
    ],
)  # fmt: skip
def test_a_part_of_another_shape_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises((TypeError, ValueError)):
        read(Tree, TREE | change)


@pytest.mark.parametrize(
    "text",
    [
        '{"a": 1, "a": 1}', '{"a": NaN}', "[Infinity]", "[-Infinity]", "[1e999]", f"[{10**30}]", f"[{'9' * 5000}]",
        '["\\ud800"]',
        '{"\\udc00": 1}', "[" * 80 + "]" * 80, "[" * 100_000, "", "\ufeff{}", "{'a': 1}", "[1,]",
    ],
)  # fmt: skip
def test_what_is_not_plain_json_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        parse(text.encode())


def test_bytes_that_are_not_utf_8_are_refused() -> None:
    for content in (b'["\xff"]', '["a"]'.encode("utf-16"), b'["\xed\xa0\x80"]'):
        with pytest.raises(ValueError, match="decode"):
            parse(content)


def test_a_check_says_what_its_claims_say() -> None:
    witness = Witness("switching", "class", ("0.5",), (("1",),), "1.2", ((1, 0),))
    claims = (
        Claim("slopes.2.1", "premise", "proved", "s", "S", required=True),
        Claim("convergence", "consequence", "refuted", "c", "S", required=True, witness=witness),
    )
    check = Check(claims, {"period_max": Bound("1/3", "inf")}, {"key": "k"})
    document = json.loads(json.dumps(check.document()))
    assert Check.from_document(document) == check
    convergence, premise = document["claims"][1], document["claims"][0]
    for change in (
        {"verdict": "proved"}, {"verdict": "undecided", "claims": []},
        {"verdict": "proved", "claims": [premise | {"required": 1}]},
        {"claims": [premise, convergence | {"status": "doubted"}]},
        {"claims": [premise, convergence | {"witness": "none"}]},
        {"bounds": {"period_max": document["bounds"]["period_max"] | {"proved": "much"}}},
        {"bounds": {"period_max": document["bounds"]["period_max"] | {"proved": 0.3}}}, {"digests": {"key": 1}},
    ):  # fmt: skip
        with pytest.raises((KeyError, TypeError, ValueError)):
            Check.from_document(document | change)
