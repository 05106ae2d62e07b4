"""report.html and the index page: well-formed, self-contained, and nothing typed by a user becomes markup."""

from __future__ import annotations

import re
from base64 import b64encode
from hashlib import sha256
from html.parser import HTMLParser

import pytest
from report_pendulum import HOSTILE, make_check, make_report

from cdobs_cli.certificate import Bound
from cdobs_cli.report.drawings import Drawings
from cdobs_cli.report.files import render
from cdobs_cli.report.index import IndexEntry, index_page
from cdobs_cli.report.model import Report

VOID = {"meta", "link", "br", "img", "path", "use", "input", "hr", "wbr"}


class Checker(HTMLParser):
    """Every element closed in order; identifiers unique; addresses and scripts collected."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.addresses: list[str] = []
        self.scripts = 0
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        self.scripts += tag == "script"
        for name, value in attrs:
            assert not name.startswith("on"), f"event handler {name}"
            if name == "id":
                self.ids.append(value or "")
            if name in ("src", "href", "xlink:href", "action"):
                self.addresses.append(value or "")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def checked(page: bytes) -> Checker:
    checker = Checker()
    checker.feed(page.decode())
    checker.close()
    assert checker.open == []
    assert len(checker.ids) == len(set(checker.ids))
    return checker


def test_the_page_is_well_formed_and_needs_neither_network_nor_script(files: dict[str, bytes]) -> None:
    checker = checked(files["report.html"])
    assert checker.scripts == 0
    assert all(address.startswith(("#", "data:")) for address in checker.addresses)
    assert not re.search(r"@import|url\((?!#)", files["report.html"].decode())


def test_references_inside_figures_resolve(files: dict[str, bytes]) -> None:
    text = files["report.html"].decode()
    checker = checked(files["report.html"])
    used = {address[1:] for address in checker.addresses if address.startswith("#")} | set(
        re.findall(r"url\(#([^)]+)\)", text)
    )
    assert used
    assert used <= set(checker.ids)


def test_a_hostile_title_is_text(files: dict[str, bytes]) -> None:
    checker = checked(files["report.html"])
    assert HOSTILE in "".join(checker.text)
    assert "<script" not in files["report.html"].decode()


def test_every_figure_is_in_the_page(report: Report, files: dict[str, bytes]) -> None:
    assert files["report.html"].decode().count('<svg role="img"') == len(report.charts) == 5


@pytest.mark.parametrize(
    "word", ["✓ proved", "✗ refuted", "? undecided", "✗ fails", "Dinh2014: Thach Ngoc Dinh", "b" * 64, "<mfrac>"]
)
def test_what_the_page_says(files: dict[str, bytes], word: str) -> None:
    assert word in files["report.html"].decode()


def test_a_report_without_check_or_run_says_so() -> None:
    files = render(make_report(), Drawings(lambda _: None))
    assert "not checked" in files["report.html"].decode()
    checked(files["report.html"])
    assert set(files) == {
        "report.md",
        "report.html",
        *(f"figures/{name}" for name in ("period_slope.svg", "period_slope.csv", "thumbnail.svg", ".drawn.json")),
    }


def test_the_index() -> None:
    report = make_report(check=make_check())
    entries = [
        IndexEntry.of(report, "a b", ("error", "states")),
        IndexEntry("bad", HOSTILE, "invalid", message="plant.A: <b>not</b> square"),
        IndexEntry(
            "zoh", "LPV", "refuted", "lpv_zoh", "period_max", Bound("0.18", "inf", "s"), "zoh/report.html", None, True
        ),
    ]
    page = index_page(entries)
    checker = checked(page)
    assert checker.scripts == 1
    assert "a%20b/report.html" in checker.addresses
    assert all(not re.match(r"(https?:)?//", address) for address in checker.addresses)
    text = "".join(checker.text)
    assert "plant.A: <b>not</b> square" in text
    assert "proved up to 0.18 s" in text
    assert "3 specs: 1 proved, 1 refuted, 1 invalid." in text


def test_an_empty_index() -> None:
    assert "0 specs: none." in "".join(checked(index_page([])).text)


def policy(page: str) -> dict[str, list[str]]:
    """The directives of the page's Content-Security-Policy, which stands before all that it governs."""
    (content,) = re.findall(r'<meta http-equiv="Content-Security-Policy" content="([^"]*)">', page)
    assert page.index("Content-Security-Policy") < min(page.index(tag) for tag in ("<style", "<link", "<title"))
    return {words[0]: words[1:] for words in (part.split() for part in content.split(";"))}


def allowed_scripts(page: str) -> list[str]:
    sources = [
        f"'sha256-{b64encode(sha256(code.encode()).digest()).decode()}'"
        for code in re.findall(r"<script>(.*?)</script>", page, re.S)
    ]
    assert page.count("<script") == len(sources)
    return sources


def test_the_policy_of_a_page_allows_what_is_in_it_and_nothing_else(files: dict[str, bytes]) -> None:
    report = files["report.html"].decode()
    index = index_page([IndexEntry("p", "P", "proved", link="p/report.html", figure="p/figures/error.svg")]).decode()
    for page, pictures, scripts in ((report, ["data:"], 0), (index, ["'self'", "file:", "data:"], 1)):
        rules = policy(page)
        assert rules["default-src"] == rules["base-uri"] == rules["form-action"] == ["'none'"]
        assert rules["style-src"] == ["'unsafe-inline'"]
        assert rules["img-src"] == pictures
        assert rules.get("script-src", []) == allowed_scripts(page)
        assert len(rules.get("script-src", [])) == scripts
        # What is not named falls to default-src: no frame, font, connection, object, worker.
        assert set(rules) - {"script-src"} == {"default-src", "style-src", "img-src", "base-uri", "form-action"}


def test_invisible_operators_of_formulas_are_not_shown_as_escapes(files: dict[str, bytes]) -> None:
    page = files["report.html"].decode()
    assert "<mo>&#8289;</mo>" in page
    assert "u2061" not in page


def test_figures_are_numbered_and_claims_lead_to_them(report: Report, files: dict[str, bytes]) -> None:
    page = files["report.html"].decode()
    numbers = re.findall(r"<strong>Figure (\d+)\.", page)
    assert numbers == [str(number) for number in range(1, len(report.charts) + 1)]
    (target,) = re.findall(r'<code>convergence</code>.*?<a href="#(figure-[a-z-]+)">figure \d+</a>', page)
    assert f'<figure id="{target}">' in page


def test_only_what_decides_is_open(files: dict[str, bytes]) -> None:
    page = files["report.html"].decode()
    folded = re.findall(r"<summary>(.*?)</summary>", page)
    assert any(one.startswith("Certificates (1)") for one in folded)
    assert "Printed in the paper (2), 1 undecided, 1 refuted" in folded
    assert not any(one.startswith("Required") for one in folded)
    assert set(re.findall(r'<li><a href="#(section-[a-z-]+)"', page)) == set(re.findall(r'<h2 id="([a-z-]+)"', page))


def test_bars_of_one_plant_have_one_scale() -> None:
    bounds = (Bound("0.5", "0.6", "s"), Bound("1.0", "1.2", "s"), Bound("50", "60", "s"))
    plants = ("pendulum", "pendulum", "motor")
    entries = [
        IndexEntry(str(k), "", "proved", bound_name="period_max", bound=bound, plant=plant)
        for k, (bound, plant) in enumerate(zip(bounds, plants, strict=True))
    ]
    widths = [float(one) for one in re.findall(r'<rect x="0" y="4" width="([\d.]+)"', index_page(entries).decode())]
    assert widths == pytest.approx([37.9, 75.8, 75.8])
