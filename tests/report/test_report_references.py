"""The reference list."""

from cdobs_cli.report.references import bibliography, cited, parse_bibliography


def test_entries_with_nested_braces_and_quotes() -> None:
    found = parse_bibliography(
        '@article{Doe2001,\n author = {Jane {van} Doe and Li, Wei},\n title = "On {L}ipschitz {{things}}",\n year=2001,\n}\n'
        "@misc{Roe1999, title={B}}"
    )
    assert found["Doe2001"].text == "Jane van Doe, Wei Li, On Lipschitz things, 2001."
    assert found["Roe1999"].fields == {"title": "B"}


def test_every_entry_of_ours_has_authors_title_and_year() -> None:
    assert {"Dinh2014", "Boukal2020", "Efimov2016", "Andrieu2013", "Andrieu2014", "Zemouche2008"} <= set(bibliography())
    for reference in bibliography().values():
        assert {"author", "title", "year"} <= set(reference.fields), reference.key


def test_cited_finds_keys_in_sources() -> None:
    assert [reference.key for reference in cited(["Efimov2016, (15); after Dinh2014", "Nobody1900"])] == [
        "Dinh2014",
        "Efimov2016",
    ]
