"""Thousands of damaged specs, read in this process: each is a spec or a SpecError, within its budget of work.

A longer run: CDOBS_MUTANTS=100000 (0.10 of it by each of ten tests).
"""

# ruff: noqa: E501 - hostile values stand side by side

from __future__ import annotations

import copy
import os
import random
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cdobs_cli.errors import SpecError
from cdobs_cli.exact import budget
from cdobs_cli.spec import model
from cdobs_cli.spec.reader import DecimalText, Document, Place, read_text

COUNT = int(os.environ.get("CDOBS_MUTANTS", "20000"))
SEEDS = 10
WORK = 50_000


def _base(text: str) -> str:
    """A shipped spec without remarks and with the first of what it expects: most of the time goes into reading."""
    head, _, expect = re.sub(r"(?m)^#.*\n|\s+#.*", "", text).partition("expect:")
    return head + "expect:" + "".join(expect.splitlines(keepends=True)[:2])


BASES = [_base(path.read_text()) for path in sorted((Path(__file__).parents[2] / "specs").glob("*.yaml"))]
VALUES = [
    "0", "-1", "1e-300", "1e400", ".inf", ".nan", "~", "null", "true", "no", "[]", "{}", "[[]]", "[1, 2]", "[[1], [2, 3]]", "{a: 1}", "auto",
    "lie", "design", "best", "'1/0'", "'sqrt(-1)'", "'9**9**9'", "'pi'", "'e**64'", "''", "' '", "x", "1/3", "'log(0)'", "'1e-200'", "99999999999999999999",
    "2019-01-01", "0x10", "1_000", "+.5", "*a", "&a 1", "!!python/object:os.system x", "|\n  text", ">-\n  text", "\"\\ud800\"", "\"\\x1b[31m\"",
]  # fmt: skip
EXPRESSIONS = [
    "({a} + {b})**60", "1/({a} - {a})", "({a} + {b} + 1)**64*({a} - {b})**64", "sin(" * 40 + "{a}" + ")" * 40, "{a}**(1/63) + {b}**(1/64)",
    "1/(1 + " * 40 + "{a}" + ")" * 40, "exp({b}*" * 40 + "{a}" + ")" * 40, "abs(min({a}, max({b}, sat({a}))))", "{a}/({b} + {a}*{b})",
    "(" * 90 + "{a}" + ")" * 90, "{a}*{b}*{a}*{b} - {a}**2*{b}**2", "log({a})*sqrt({b})", "monod({a}, {b}) + contois({a}, {b}, 1)", "{a}*" * 90 + "{b}",
    "{a} + " * 300 + "{b}", "tan({a}/{b})**-64", "0*{a}", "{a}", "-{b}", "1e99*{a}", "{a} if {b} else 1", "{a}.real", "[{a}]", "lambda: {a}", "({a}",
]  # fmt: skip
PIECES = [
    "[",
    "]",
    "{",
    "}",
    ": ",
    "- ",
    ", ",
    "\n",
    "  ",
    "\t",
    "? ",
    "'",
    '"',
    "%",
    "#",
    "---\n",
    "\x00",
    "\x85",
    "\u2028",
    "\ufeff",
    "é",
    "\x1b",
]
WORDS = sorted(set(re.findall(r"[A-Za-z_]+", "\n".join(BASES))))


def mutant(draw: random.Random) -> str:
    text = draw.choice(BASES)
    for _ in range(draw.choice([1, 1, 1, 2, 3, 6])):
        text = draw.choice(WAYS)(draw, text)
    return text


def _replaced(draw: random.Random, text: str, pattern: str, by: str) -> str:
    """One place of those that match, replaced."""
    found = list(re.finditer(pattern, text))
    if not found:
        return text
    place = draw.choice(found)
    return text[: place.start()] + by + text[place.end() :]


def other_value(draw: random.Random, text: str) -> str:
    return _replaced(
        draw, text, r"(?<=: )[^\n{\[]+|(?<=[\[ ])[-\w.]+(?=[\],])|\[[^\[\]]*\]|\{[^{}]*\}", draw.choice(VALUES)
    )


def other_expression(draw: random.Random, text: str) -> str:
    states = re.search(r"states: \[([^\]]*)\]", text)
    names = [name.strip() for name in states.group(1).split(",")] if states else ["x"]
    typed = draw.choice(EXPRESSIONS).format(a=draw.choice(names), b=draw.choice(names))
    return _replaced(draw, text, r"\"[^\"\n]*\"", f'"{typed}"')


def other_word(draw: random.Random, text: str) -> str:
    return _replaced(draw, text, r"[A-Za-z_]+", draw.choice(WORDS))


def other_characters(draw: random.Random, text: str) -> str:
    start = draw.randrange(len(text) + 1)
    return text[:start] + draw.choice(PIECES) + text[start + draw.choice([0, 0, 1, 3, 10]) :]


def other_line(draw: random.Random, text: str) -> str:
    """A line lost, doubled, moved, indented or taken from another spec."""
    lines = text.split("\n")
    k, other = draw.randrange(len(lines)), draw.choice(draw.choice(BASES).split("\n"))
    lines[k : k + 1] = draw.choice(
        [[], [lines[k]] * 2, [f"  {lines[k]}"], [lines[k].removeprefix("  ")], [lines[k], other], [other]]
    )
    return "\n".join(lines)


def other_number(draw: random.Random, text: str) -> str:
    number = draw.choice(["0", "1e9", "1e-9", "-2", "64", "65", "1" * 1001, "0.1e1", str(draw.random())])
    return _replaced(draw, text, r"\d+(\.\d+)?", number)


WAYS: list[Callable[[random.Random, str], str]] = [
    other_value, other_value, other_expression, other_word, other_characters, other_line, other_number,
]  # fmt: skip


DOCUMENTS = [read_text(text, "m.yaml") for text in BASES]
PARTS = [value for document in DOCUMENTS for value in document.root.values()] + [
    None,
    True,
    0,
    -1,
    10**30,
    DecimalText("1e-300"),
    DecimalText("1e400"),
    DecimalText("0.5"),
    "",
    "1/0",
    "sqrt(-1)",
    "pi",
    "e**64",
    "auto",
    "x",
    "lie",
    "\x1b[31m\n::error::",
    [],
    {},
    [[]],
    [1, [2]],
    {"a": 1},
    {"lower": [0], "upper": [1]},
    {"file": "/etc/passwd"},
    ["0"] * 9,
]


def damaged(draw: random.Random) -> Document:
    """A document with a few values or keys replaced: what YAML cannot spoil is left to `mutant`."""
    root = copy.deepcopy(draw.choice(DOCUMENTS).root)
    for _ in range(draw.choice([1, 1, 2, 4])):
        inside: Any = root
        while True:
            key = draw.choice(list(inside) if isinstance(inside, dict) else range(len(inside)))
            if not isinstance(inside[key], dict | list) or not inside[key] or draw.random() < 0.25:
                break
            inside = inside[key]
        if isinstance(inside, dict) and draw.random() < 0.2:
            inside[draw.choice(WORDS)] = inside.pop(key)
        elif isinstance(inside[key], str) and draw.random() < 0.5:
            names = (root.get("plant") or {}).get("states") if isinstance(root.get("plant"), dict) else None
            names = [str(name) for name in names] if isinstance(names, list) and names else ["x"]
            inside[key] = draw.choice(EXPRESSIONS).format(a=draw.choice(names), b=draw.choice(names))
        else:
            inside[key] = copy.deepcopy(draw.choice(PARTS))
    return Document("m.yaml", root, {(): Place("m.yaml", 1, 1)})


@pytest.mark.parametrize("seed", range(SEEDS))
def test_mutants(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    monkeypatch.setattr(model, "READING", WORK)
    path = tmp_path / "m.yaml"
    draw = random.Random(seed)
    outcomes: Counter[str] = Counter()
    for number in range(COUNT // SEEDS):
        if number % 3 == 0:
            text = mutant(draw)
            path.write_bytes(text.encode())
            outcome = tried(lambda: model.load(path), text, seed)
        else:
            document = damaged(draw)
            outcome = tried(lambda document=document: model.load_document(document, path), document.root, seed)  # type: ignore[misc]
        outcomes[outcome] += 1
    # Neither all refused at the door nor all read.
    assert outcomes["read"] > 0.05 * outcomes.total()
    assert outcomes["refused"] > 0.3 * outcomes.total()


def tried(load: Callable[[], model.Spec], what: object, seed: int) -> str:
    before = budget.spent()
    try:
        outcome = read(load)
    except BaseException as error:
        raise AssertionError(f"{type(error).__name__}: {error}, of a spec of seed {seed}:\n{what}") from error
    # The last step may pass the limit, by no more than one step can cost.
    assert budget.spent() - before < 40 * WORK
    return outcome


def read(load: Callable[[], model.Spec]) -> str:
    try:
        load().normalised()
    except SpecError as error:
        problems = error.problems
    else:
        problems = ()
    assert all(problem.file is not None and problem.text and str(problem).encode() for problem in problems)
    return "refused" if problems else "read"
