"""A good spec, and what loading a variation of it says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from spec_pendulum import changed

from cdobs_cli.errors import SpecError
from cdobs_cli.spec.model import Spec, load


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write a spec's text (or bytes) and give its path."""

    def make(text: str | bytes, name: str = "spec.yaml") -> Path:
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return make


@pytest.fixture
def loaded(write: Callable[..., Path]) -> Callable[..., Spec]:
    """Load the pendulum with parts of its text replaced."""

    def make(*changes: tuple[str, str]) -> Spec:
        return load(write(changed(*changes)))

    return make


@pytest.fixture
def mistakes(write: Callable[..., Path]) -> Callable[..., list[str]]:
    """`line:column: field: text` of every mistake in a text."""

    def make(text: str | bytes) -> list[str]:
        path = write(text)
        with pytest.raises(SpecError) as caught:
            load(path)
        for problem in caught.value.problems:
            assert problem.file is not None
        return [str(problem).removeprefix(f"{path}:") for problem in caught.value.problems]

    return make
