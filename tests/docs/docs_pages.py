"""The pages of the site, as tests read them: blocks, links, anchors; and the script that builds it."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from typing import Any

import pytest
from command import ROOT

DOCS = ROOT / "docs"
# Those that are written, by name.
WRITTEN = {path.relative_to(DOCS).as_posix(): path.read_text(encoding="utf-8") for path in sorted(DOCS.rglob("*.md"))}
_FENCED = re.compile(r"^```(\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def builder() -> Any:
    """docs/build.py as a module; it needs no generator to be loaded."""
    spec = importlib.util.spec_from_file_location("docs_build", DOCS / "build.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def blocks(language: str, *pages: str) -> list[Any]:
    """The fenced blocks of the written pages (or of some), each as the parameter of a test."""
    return [
        pytest.param(block, id=f"{name}-{k}")
        for name, text in WRITTEN.items()
        if name in (pages or WRITTEN)
        for k, (found, block) in enumerate(_FENCED.findall(text))
        if found == language
    ]


def commands(block: str) -> list[str]:
    """What is typed in a block of the console."""
    return [line.removeprefix("$ ") for line in block.splitlines() if line.startswith("$ ")]


def anchors(text: str, slug: Any) -> set[str]:
    """Of the headings."""
    return {slug(heading) for heading in re.findall(r"^#+ (.+)$", _FENCED.sub("", text), re.MULTILINE)}


def links(text: str) -> list[str]:
    """The targets of links and pictures."""
    return re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`\n]*`", "", _FENCED.sub("", text)))


def entries(text: str) -> list[str]:
    """The pages that its tables of contents name."""
    trees = [block for language, block in _FENCED.findall(text) if language == "{toctree}"]
    return [line for tree in trees for line in tree.splitlines() if line and not line.startswith(":")]


def target(pages: Path, name: str, link: str) -> Path:
    """The file that a link of a page leads to."""
    path = link.partition("#")[0]
    return ((pages / name).parent / path if path else pages / name).resolve()
