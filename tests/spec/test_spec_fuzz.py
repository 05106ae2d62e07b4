"""Whatever the bytes, `load` returns a spec or raises SpecError, and soon."""

# ruff: noqa: E501 - each case stands on one line

from __future__ import annotations

import random
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from spec_pendulum import PENDULUM

from cdobs_cli.errors import SpecError
from cdobs_cli.spec.model import Spec, load

SETTINGS = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
WORDS = [
    "[", "]", "{", "}", ": ", "- ", ", ", "\n", "  ", "\t", "&a ", "*a", "!!", "!x ", "? ", "| ", "> ", "'", '"', "%", "#", "---\n",
    "...\n",     "null", "true", "~", ".nan", "-.inf", "1e-3", "1e400", "-1", "0", "9**9**9", "sqrt(-1)", "1/0", "auto", "lie", "theta", "u", "pi", "e",
    "states", "inputs", "parameters", "A", "phi", "B", "C", "lipschitz", "domain", "where", "dynamics", "output", "coordinates", "map",
    "inverse", "disturbance", "lower", "upper", "sampling", "period", "updated", "noise", "family", "gain", "set", "matrices", "signals",
    "sampling_times", "initial_box", "equals", "tolerance", "file", "\x00", "\x85", "\u2028", "\ufeff", "é", "x" * 50,
]  # fmt: skip


def outcome(path: Path, data: bytes) -> Spec | SpecError:
    path.write_bytes(data)
    start = time.process_time()
    try:
        result: Spec | SpecError = load(path)
    except SpecError as error:
        result = error
    if isinstance(result, SpecError):
        assert result.problems
        assert all(problem.file and str(problem) for problem in result.problems)
    else:
        result.normalised()
    assert time.process_time() - start < 5
    return result


@SETTINGS
@given(data=st.binary(max_size=400))
def test_random_bytes(tmp_path: Path, data: bytes):
    assert isinstance(outcome(tmp_path / "f.yaml", data), SpecError)


@SETTINGS
@given(words=st.lists(st.sampled_from(WORDS), max_size=60))
def test_random_words(tmp_path: Path, words: list[str]):
    assert isinstance(outcome(tmp_path / "f.yaml", "".join(words).encode()), SpecError)


@SETTINGS
@given(seed=st.integers(0, 2**32), count=st.integers(1, 6))
def test_a_good_spec_with_parts_replaced(tmp_path: Path, seed: int, count: int):
    draw, text = random.Random(seed), PENDULUM
    for _ in range(count):
        start = draw.randrange(len(text))
        text = text[:start] + draw.choice(WORDS) + text[start + draw.choice([0, 0, 1, 3, 10]) :]
    outcome(tmp_path / "f.yaml", text.encode())


VALUES = st.recursive(
    st.sampled_from(
        [
            "null",
            "true",
            "0",
            "-1",
            "1e-3",
            "1e99",
            '"sqrt(2)"',
            '"x"',
            "auto",
            '"9**9**9"',
            "[]",
            "{}",
            '"exp(exp(exp(9)))"',
            ".5",
        ]
    ),
    lambda inner: (
        st.lists(inner, max_size=4).map(lambda parts: f"[{', '.join(parts)}]")
        | st.dictionaries(st.sampled_from(WORDS[38:73]), inner, max_size=3).map(
            lambda parts: "{" + ", ".join(f"{name}: {part}" for name, part in parts.items()) + "}"
        )
    ),
    max_leaves=10,
)


@SETTINGS
@given(data=st.data())
def test_a_good_spec_with_a_value_replaced(tmp_path: Path, data: st.DataObject):
    lines = PENDULUM.splitlines()
    for _ in range(data.draw(st.integers(1, 3))):
        number = data.draw(st.integers(0, len(lines) - 1))
        key, colon, _ = lines[number].partition(": ")
        if colon:
            lines[number] = f"{key}: {data.draw(VALUES)}"
    outcome(tmp_path / "f.yaml", "\n".join(lines).encode())


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000, "{a: " * 50_000, "- " * 100_000, "a:\n" + "".join(" " * i + "- \n" for i in range(1, 700)), "? " * 100_000,
        "a: " + "9" * 100_000, "a: '" + "y" * 200_000 + "'", "# " + "z" * 200_000, "a: [" + "x, " * 80_000 + "]", "\n" * 250_000,
        "%YAML 1.1\n" * 20_000, "a: |\n" + " x\n" * 80_000, "'" * 200_000, "&a " * 80_000, "a: !" + "t" * 200_000, "k" * 200_000 + ": 1",
        PENDULUM.replace("sin(theta)/g", "(" * 3000), PENDULUM.replace("sin(theta)/g", "9**9**9**9"),
        PENDULUM.replace("sin(theta)/g", "-" * 1500 + "1"), PENDULUM.replace("sin(theta)/g", "theta**64**64"),
        PENDULUM.replace("sin(theta)/g", "*".join(["(1+theta)**64"] * 100)), PENDULUM.replace("sin(theta)/g", "exp(" * 90 + "9" + ")" * 90),
        PENDULUM.replace("sin(theta)/g", "[" * 90 + "]" * 90), PENDULUM.replace("sin(theta)/g", "lambda: 0"),
        PENDULUM.replace("sin(theta)/g", "0x1for x in y"), PENDULUM.replace("horizon: 20", "horizon: 1e99"),
    ],
)  # fmt: skip
def test_hostile_texts(tmp_path: Path, text: str):
    found = outcome(tmp_path / "f.yaml", text.encode())
    assert isinstance(found, SpecError) or "(1+theta)" in text
