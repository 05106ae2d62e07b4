"""The site is whole without its generator: every page is listed, every link leads somewhere, nothing is fetched."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from docs_pages import anchors, builder, entries, links, target

from cdobs_cli.exact.parser import TYPED_FUNCTIONS
from cdobs_cli.families import FAMILIES
from cdobs_cli.report.references import bibliography
from cdobs_cli.spec.schema import json_schema

build = builder()


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    build.write_pages(folder)
    return folder


def texts(pages: Path) -> dict[str, str]:
    return {path.relative_to(pages).as_posix(): path.read_text(encoding="utf-8") for path in pages.rglob("*.md")}


def test_every_link_leads_to_a_page_and_a_heading(pages: Path) -> None:
    found = texts(pages)
    drawn = {pages.resolve() / "figures" / name for _, names in build.TUTORIAL.values() for name in names}
    checked = 0
    for name, text in found.items():
        for link in links(text):
            assert "://" not in link, f"{name} leads away: {link}"
            path = target(pages, name, link)
            assert path in drawn or path.is_file(), f"{name}: {link}"
            heading = link.partition("#")[2]
            if heading:
                assert heading in anchors(path.read_text(encoding="utf-8"), build.slug), f"{name}: {link}"
            checked += 1
    assert checked > len(found)


def test_every_page_is_in_a_table_of_contents(pages: Path) -> None:
    found = texts(pages)
    listed = [target(pages, name, f"{entry}.md") for name, text in found.items() for entry in entries(text)]
    assert len(listed) == len(set(listed))
    notebooks = {path.with_suffix(".md") for path in pages.resolve().glob("*.ipynb")}
    every = {pages.resolve() / name for name in found} | notebooks
    assert notebooks and set(listed) | {pages.resolve() / "index.md"} == every


def test_every_family_has_a_page(pages: Path) -> None:
    assert {path.stem for path in (pages / "families").glob("*.md")} == set(FAMILIES)


def test_pages_from_the_code_leave_nothing_out(pages: Path) -> None:
    spec, functions = (pages / "spec.md").read_text(), (pages / "functions.md").read_text()
    schema = json_schema()
    blocks = [schema, *schema["definitions"].values()]
    for key in (key for block in blocks for key in block.get("properties", {})):
        assert f"- **`{key}`** (" in spec
    assert all(f"| `{name}` |" in functions for name in TYPED_FUNCTIONS)
    gallery = (pages / "gallery.md").read_text()
    assert all(f"### {path.stem}\n" in gallery for path in build.SPECS.glob("*.yaml"))
    assert all(f"**{key}**" in (pages / "sources.md").read_text() for key in bibliography())


def test_words_are_included_where_the_package_has_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "EXPLAIN", "no_words_at_all")
    assert list(build.word_pages()) == ["words"]
    (tmp_path / "some_words").mkdir()
    (tmp_path / "some_words" / "__init__.py").write_text("")
    (tmp_path / "some_words" / "verdicts.md").write_text("# Verdicts\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(build, "EXPLAIN", "some_words")
    found = build.word_pages()
    assert found["words/verdicts"] == "# Verdicts\n" and entries(found["words"]) == ["words/verdicts"]


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ('<script src="https://elsewhere/a.js"></script>', 1),
        ('<link rel="stylesheet" href="//elsewhere/a.css">', 1),
        ("<style>@font-face {src: url('https://elsewhere/a.woff')}</style>", 1),
        ('<img src="pictures/a.svg"><script src="_static/a.js"></script><a href="https://elsewhere">there</a>', 0),
    ],
)
def test_what_a_page_would_fetch_is_found(tmp_path: Path, text: str, count: int) -> None:
    (tmp_path / "page.html").write_text(text)
    assert len(build.fetched(tmp_path)) == count


def test_nothing_here_needs_the_generator() -> None:
    assert not {"sphinx", "myst_parser"} & set(sys.modules)
