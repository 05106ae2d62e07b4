"""YAML text to values: YAML 1.2 scalars, places, and what is refused."""

# ruff: noqa: E501 - each case stands on one line

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from cdobs_cli.errors import SpecError
from cdobs_cli.spec.reader import MAX_BYTES, DecimalText, Place, read, read_text


def refused(text: str) -> list[str]:
    try:
        document = read_text(text, "f")
    except SpecError as error:
        return [str(problem) for problem in error.problems]
    return [str(problem) for problem in document.problems]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", "1e-3"), ("-2e-4", "-2e-4"), (".5", ".5"), ("1.", "1."), ("+0.10", "+0.10"), ("1E5", "1E5"),
        ("12", 12), ("-7", -7), ("010", 10), ("yes", "yes"), ("no", "no"), ("on", "on"), ("Off", "Off"), ("y", "y"),
        ("true", True), ("False", False), ("null", None), ("~", None), ("", None), ("1_000", "1_000"), ("0x1f", "0x1f"),
        ("12:30", "12:30"), ("2024-01-01", "2024-01-01"), ("'1'", "1"), ('"true"', "true"), ("e", "e"), ("1e", "1e"), (".", "."),
    ],
)  # fmt: skip
def test_scalars_follow_yaml_1_2(text, value):
    found = read_text(f"a: {text}", "f").root["a"]
    assert found == value
    assert type(found) in ((type(value), DecimalText) if isinstance(value, str) else (type(value),))


def test_decimals_keep_their_text_and_quoted_ones_are_words():
    document = read_text("a: 1.10\nb: '1.10'", "f")
    assert isinstance(document.root["a"], DecimalText)
    assert not isinstance(document.root["b"], DecimalText)


def test_every_value_and_key_has_its_place():
    document = read_text("a: 1\nb:\n  - x\n  - {c:   [2, 3]}\n", "f")
    assert document.place(("a",)) == Place("f", 1, 4)
    assert document.place(("b", 0)) == Place("f", 3, 5)
    assert document.place(("b", 1, "c", 1)) == Place("f", 4, 15)
    assert document.place(("b", 1, "c"), key=True) == Place("f", 4, 6)
    assert document.place(("b", 1, "missing")) == Place("f", 4, 5)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a: 1\nb: 2\na: 3", ["f:3:1: a: the key \"a\" is already given at line 1"]),
        ("a: &x 1\nb: *x", ["f:1:4: a: an anchor; got &x; write the value out where it is used", "f:2:4: b: an alias; got *x; write the value out"]),
        ("a: !!python/object/apply:os.system [x]", ["f:1:4: a: a tag; got tag:yaml.org,2002:python/object/apply:os; plain values need none"]),
        ("a: !local x", ["f:1:4: a: a tag; got !local; plain values need none"]),
        ("a: 1\n---\nb: 2", ["f:2:1: spec: a second document; allowed: one document a file"]),
        ("? [1]\n: 2", ["f:1:3: ?: a key is a name; got []"]),
        ("a: .nan\nb: [-.inf]", [
            "f:1:4: a: a finite number is expected; got .nan; leave an open end of an interval out with null",
            "f:2:5: b[0]: a finite number is expected; got -.inf; leave an open end of an interval out with null",
        ]),
        ("a: b: c", ['f:1:5: spec: not YAML: a second colon on the line; put a value that holds a colon in quotes: a: "b: c"']),
        ("a: [1", ["f:1:6: a: not YAML: a list that is not closed; write ] at its end, and , between its entries"]),
        ("a:\x00", ["f:1:3: spec: a character that YAML does not allow; got U+0000"]),
        ("%TAG ! tag:x,2000:\n---\na: 1", ["f:1:1: spec: a %TAG directive; allowed: no tags"]),
        ('a: "\\U99999999"', ["f:1:1: spec: not YAML: Python int too large to convert to C int"]),
        ("a: [" + "1," * 1100 + "]", ["f:1:2053: a: too many entries; allowed: at most 1024"]),
        ("a: '" + "x" * 4001 + "'", ["f:1:4: spec: a value that is too long; allowed: at most 4000 characters"]),
    ],
)  # fmt: skip
def test_what_is_refused_is_told_with_its_place(text, told):
    assert refused(text) == told


@pytest.mark.parametrize("opening", ["[", "{a: ", "- ", "? ", "[[{b: ", "!!set {", "&a ["])
def test_deep_nesting_is_refused_before_any_recursion(opening):
    start = time.process_time()
    told = refused(opening * 100_000 if len(opening) < 2 else opening * (MAX_BYTES // len(opening)))
    assert told
    assert time.process_time() - start < 5


def test_a_bomb_of_aliases_is_never_unfolded():
    lines = ["a0: &a0 [x, x]"] + [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)]
    assert all("anchor" in line or "alias" in line or "too many" in line for line in refused("\n".join(lines)))


def test_many_mistakes_end_the_reading():
    assert refused("[" + "*a, " * 300 + "]")[-1].endswith("too many mistakes")


def test_too_many_values_are_refused():
    rows = "\n".join("- [" + ",".join(["1"] * 1000) + "]" for _ in range(30))
    assert "too many values" in refused(rows)[0]


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"a: 1\nb: \xff\xfe", "2:4: spec: the file is not UTF-8; got byte 0xFF"),
        (b"\x89PNG\r\n\x1a\n\x00", "1:1: spec: the file is not UTF-8; got byte 0x89"),
        ("ä: €\nb: ".encode() + b"\x80", "2:4: spec: the file is not UTF-8; got byte 0x80"),
        (b"a: \x07", "1:4: spec: a character that YAML does not allow; got U+0007"),
        (b" " * (MAX_BYTES + 1), "spec: the file is too large; allowed: at most 262144 bytes"),
    ],
)
def test_files_that_are_not_text(tmp_path: Path, data, told):
    path = tmp_path / "f.yaml"
    path.write_bytes(data)
    with pytest.raises(SpecError) as caught:
        read(path)
    assert str(caught.value).removeprefix(f"{path}:").lstrip() == told


def test_files_that_cannot_be_read(tmp_path: Path):
    def told(path: Path) -> str:
        with pytest.raises(SpecError) as caught:
            read(path)
        return str(caught.value).removeprefix(f"{path}: ")

    assert told(tmp_path / "missing.yaml") == "spec: no such file"
    assert told(tmp_path) == "spec: a YAML file is expected; got a directory"
    assert "not a file name" in told(Path("a\0b"))
    os.mkfifo(tmp_path / "pipe")
    assert told(tmp_path / "pipe") == "spec: a YAML file is expected; got not a regular file"
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    assert "cannot be read" in told(tmp_path / "loop")
    locked = tmp_path / "locked.yaml"
    locked.write_text("a: 1")
    locked.chmod(0)
    if os.geteuid() != 0:
        assert "permission denied" in told(locked)


@pytest.mark.parametrize("half", [r"\uD800", r"\uDFFF", r"\U0000DC80", r"\uD83D\uDE00"])
@pytest.mark.parametrize("text", ['a: 1\nb: "{}"\n', 'a: 1\n"b {}": 1\n', 'a: 1\n["{}"]: 1\n', 'a: 1\nb: [x, "y{}"]\n'])
def test_half_a_surrogate_pair_is_refused_at_its_line(text: str, half: str):
    """YAML has no way to write one; what Python makes of it cannot be written to a file."""
    with pytest.raises(SpecError) as caught:
        read_text(text.format(half), "f.yaml")
    problem = caught.value.problems[-1]
    assert problem.line == 2
    assert problem.what == "half of a surrogate pair is no character"
    str(problem).encode()
