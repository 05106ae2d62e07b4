"""What commands do with artefacts that are not what was written: make them anew, or refuse them, and say so."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
from command import Done, forked

from cdobs_cli.store import ARTEFACTS, sealed


@pytest.fixture
def here(finished: Path, tmp_path: Path) -> Path:
    """A folder with the pendulum and its results."""
    return Path(shutil.copytree(finished, tmp_path / "here"))


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {name: (folder / "results" / "p" / name).read_bytes() for name in ARTEFACTS}


def command(folder: Path, *arguments: str) -> Done:
    return forked([arguments[0], "p.yaml", *arguments[1:]], folder)


@pytest.mark.parametrize("name", ARTEFACTS)
def test_an_edited_artefact_is_refused_by_report_and_made_anew_by_run(here: Path, name: str) -> None:
    clean = bytes_of(here)
    path = here / "results" / "p" / name
    json_text = name.endswith("json")
    path.write_bytes(
        clean[name].replace(b'"schema_version"', b'"x": 1, "schema_version"', 1) if json_text else clean[name][:-9]
    )
    refused = command(here, "report")
    assert refused.returncode == 2
    assert f"{name} was edited or damaged" in refused.stderr
    for stage in ("check", "simulate"):
        assert command(here, stage).returncode == 0
    assert bytes_of(here) == clean


def test_statuses_and_numbers_edited_in_a_check_do_not_reach_the_exit_code(here: Path) -> None:
    clean = bytes_of(here)
    path = here / "results" / "p" / "check.json"
    for old, new in (
        ('"verdict": "proved"', '"verdict": "refuted"'),
        ('"status": "proved"', '"status": "refuted"'),
        ('"0.', '"999.'),
    ):
        path.write_text(clean["check.json"].decode().replace(old, new))
        assert command(here, "check").returncode == 0
        assert bytes_of(here) == clean


@pytest.mark.parametrize("name", ARTEFACTS)
def test_a_pipe_in_place_of_an_artefact_is_refused_at_once(here: Path, name: str) -> None:
    path = here / "results" / "p" / name
    path.unlink()
    os.mkfifo(path)
    for stage in ("check", "simulate", "report", "run"):
        done = command(here, stage)
        assert done.returncode == 3
        assert f"{name} is not a regular file; move it away" in done.stderr
        assert "internal error" not in done.stderr


def plain_pages() -> None:
    pages = {"report.md": b"text", "report.html": b"page"}
    pytest.MonkeyPatch().setattr("cdobs_cli.report.files.render", lambda *_: pages)


def test_a_report_whose_mark_or_page_was_edited_is_made_anew(here: Path) -> None:
    folder = here / "results" / "p"
    for name, content in (
        (".report.sha256", b"\xff"),
        ("report.html", b"proved"),
        ("report.md", b""),
        ("report.html", None),
    ):
        (folder / name).unlink()
        if content is None:
            os.mkfifo(folder / name)
        else:
            (folder / name).write_bytes(content)
        assert forked(["report", "p.yaml"], here, plain_pages).returncode == 0
        assert (folder / "report.html").read_bytes() == b"page"
        assert (folder / "report.md").read_bytes() == b"text"
    assert forked(["report", "p.yaml"], here).returncode == 0
    assert (folder / "report.html").read_bytes() == b"page", "what is current is not made again"


def test_a_run_of_another_design_is_left_out_of_the_report(here: Path) -> None:
    path = here / "results" / "p" / "simulation.json"
    document = json.loads(path.read_text())
    document["digests"]["design"] = "0" * 64
    path.write_text(json.dumps(sealed(document)))
    done = command(here, "report", "--format", "json")
    assert done.returncode == 0
    assert json.loads(done.stdout)["results"][0]["simulation"] is None


def test_artefacts_name_what_they_came_from(here: Path) -> None:
    documents = {name: json.loads(content) for name, content in bytes_of(here).items() if name.endswith("json")}
    digests = {name: document["digests"] for name, document in documents.items()}
    assert {name: set(named) for name, named in digests.items()} == {
        "design.json": {"key", "content"}, "check.json": {"key", "design", "content"},
        "simulation.json": {"key", "design", "archive", "content"},
    }  # fmt: skip
    assert digests["check.json"]["design"] == digests["simulation.json"]["design"] == digests["design.json"]["content"]
