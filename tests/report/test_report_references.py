"""The reference list."""

import re
from importlib.resources import files

from cdobs_cli.report.references import bibliography, cited, parse_bibliography


def test_entries_with_nested_braces() -> None:
    entries = parse_bibliography(
        "@article{Doe2001,\n  author = {Jane {van} Doe and Li, Wei},\n"
        "  title  = {On {L}ipschitz {{things}}},\n  year   = {2001},\n}\n"
        "\n@misc{Roe1999,\n  title = {B}\n}\n"
    )
    assert entries["Doe2001"].text == "Jane van Doe, Wei Li, On Lipschitz things, 2001."
    assert entries["Roe1999"].fields == {"title": "B"}


def test_every_entry_of_ours_has_authors_title_and_year() -> None:
    text = (files("cdobs_cli") / "references.bib").read_text(encoding="utf-8")
    assert set(bibliography()) == set(re.findall(r"@\w+\{(\w+)", text))  # none is overlooked
    assert sum(len(reference.fields) for reference in bibliography().values()) == text.count(" = {")
    assert {"Dinh2014", "Boukal2020", "Efimov2016", "Andrieu2013", "Andrieu2014", "Zemouche2008"} <= set(bibliography())
    for reference in bibliography().values():
        assert {"author", "title", "year"} <= set(reference.fields), reference.key


def test_cited_finds_keys_in_sources() -> None:
    assert [reference.key for reference in cited(["Efimov2016, (15); after Dinh2014", "Nobody1900"])] == [
        "Dinh2014",
        "Efimov2016",
    ]
