"""`family: auto`: which families are tried, which is chosen, why, and that equal specs choose alike."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from command import made

from cdobs_cli import choice
from cdobs_cli.choice import Trial
from cdobs_cli.errors import SpecError
from cdobs_cli.families import FAMILIES
from cdobs_cli.outcome import Result
from cdobs_cli.pipeline import Work, check, synthesize
from cdobs_cli.scaffold import example
from cdobs_cli.spec.model import load
from cdobs_cli.store import Store

SPEC = """\
spec_version: 1
plant: {states: [x], A: [[AAA]], phi: ["0"], lipschitz: [[0]]MORE}
measurement: {C: [[1]], sampling: {LAW}}
OBSERVER
simulation: {horizon: 4, initial_state: [0.5], START}
"""


def text(observer: str = "", *, A: str = "-1", law: str = "period: 0.5", start: str = "initial_estimate: [0]",
         more: str = "") -> str:  # fmt: skip
    parts = {"AAA": A, "LAW": law, "OBSERVER": observer, "START": start, "MORE": more}
    filled = SPEC
    for name, part in parts.items():
        filled = filled.replace(name, part)
    return filled


def rows(result: Result) -> dict[str, dict[str, Any]]:
    assert result.design is not None, result.messages
    return {row["family"]: row for row in result.design["details"]["choice"]}


@pytest.fixture(scope="module")
def scalar(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    folder = tmp_path_factory.mktemp("choice")
    return folder, made(folder, text())


def test_every_family_has_a_row_with_a_reason(scalar: tuple[Path, Result]) -> None:
    told = rows(scalar[1])
    assert told.keys() == FAMILIES.keys()
    assert all(row["why"] for row in told.values())
    assert all(row.keys() == {"family", "outcome", "verdict", "period", "rate", "why"} for row in told.values())
    assert "known box of x(0)" in told["interval"]["why"] and told["interval"]["outcome"] == "not taken"
    assert "chooses its sampling instants" in told["updated_sampling"]["why"]


def test_a_long_expression_is_not_quoted(tmp_path: Path) -> None:
    long = (
        text()
        .replace('phi: ["0"]', 'phi: ["-x + sin(x)*cos(x)*tanh(x)/(1 + x**2 + x**4 + x**6)"]')
        .replace("[[0]]", "auto")
    )
    (tmp_path / "s.yaml").write_text(long)
    spec = load(tmp_path / "s.yaml")
    assert spec.choice is not None
    assert spec.choice.refused["interval"] == (
        "plant.phi[0]: this observer is for linear plants: phi may use the inputs only"
    )


def test_the_largest_proved_rate_is_chosen(scalar: tuple[Path, Result]) -> None:
    """A full jump resets the error of a scalar plant: no held innovation is as fast."""
    told, design = rows(scalar[1]), scalar[1].design
    assert design is not None and design["family"] == "reachability"
    assert float(told["reachability"]["rate"]) > float(told["lpv_zoh"]["rate"])
    assert told["reachability"]["why"].startswith("chosen: proved, with the largest decay rate")
    assert told["lpv_zoh"]["why"] == "proved, with a smaller decay rate"
    assert scalar[1].check is not None and scalar[1].check["verdict"] == "proved" and scalar[1].status == "ok"


def test_the_report_and_the_terminal_say_why(scalar: tuple[Path, Result]) -> None:
    report = (scalar[0] / "out" / "report.md").read_text()
    for name, row in rows(scalar[1]).items():
        line = next(line for line in report.splitlines() if line.startswith(f"| {name.replace('_', chr(92) + '_')} |"))
        assert re.sub(r"\\", "", line).rstrip(" |").endswith(row["why"])
    assert any(line.startswith("  family: reachability (chosen: ") for line in scalar[1].summary)


@pytest.mark.parametrize("observer", ["", "observer:", "observer: {family: auto}"])
def test_a_block_left_out_is_the_same_spec(tmp_path: Path, observer: str) -> None:
    (tmp_path / "a.yaml").write_text(text())
    (tmp_path / "b.yaml").write_text(text(observer))
    assert load(tmp_path / "a.yaml").normalised() == load(tmp_path / "b.yaml").normalised()


def test_equal_specs_choose_alike_and_nothing_is_redone(scalar: tuple[Path, Result], tmp_path: Path) -> None:
    made(tmp_path, text("# a comment\n"), ("synthesize", "check"))
    for name in ("design.json", "check.json"):
        assert (tmp_path / "out" / name).read_bytes() == (scalar[0] / "out" / name).read_bytes()
    work = Work(load(tmp_path / "s.yaml"), Store(tmp_path / "out"), effort=0)
    assert check(work).verdict == "proved" and not work.redone
    assert work.spec.observer.name == "reachability"


def test_the_key_reads_what_the_choice_reads(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(text())
    keys = set()
    for observer in ("", "observer: {family: auto, objective: max_period}", "observer: {family: reachability}"):
        (tmp_path / "a.yaml").write_text(text(observer))
        work = Work(load(tmp_path / "a.yaml"), Store(tmp_path / "out"), effort=0)
        before = work.design_key
        synthesize(work)
        assert work.design_key == before
        keys.add(before)
    assert len(keys) == 3


def test_a_stored_design_of_a_family_that_does_not_take_the_plant_is_none(tmp_path: Path) -> None:
    made(tmp_path, text(), ("synthesize",))
    store = Store(tmp_path / "out")
    clean = (tmp_path / "out" / "design.json").read_bytes()
    stored = json.loads(clean)
    for name in ("interval", "auto", "nothing"):
        store.write("design.json", stored | {"family": name})
        assert made(tmp_path, text(), ("check",)).status == "ok"
        assert (tmp_path / "out" / "design.json").read_bytes() == clean


def test_bounds_enclose_the_state_where_a_box_is_known(tmp_path: Path) -> None:
    start = "initial_box: {lower: [0], upper: [1]}"
    told = rows(made(tmp_path, text(start=start), ("synthesize",)))
    assert told["interval"]["outcome"] != "not taken" and told["interval"]["verdict"] == "proved"


def test_an_observer_that_chooses_its_instants_is_the_only_one(tmp_path: Path) -> None:
    chain = text(law="updated: true").replace("states: [x]", "states: [x]").replace("[[-1]]", "[[0]]")
    result = made(tmp_path, chain)
    assert result.design is not None and result.design["family"] == "updated_sampling"
    row = rows(result)["updated_sampling"]
    assert (row["why"], row["verdict"]) == ("chosen: the only family that takes plant and law", None)
    assert result.check is not None and result.check["verdict"] == "proved"


def test_the_longest_period(tmp_path: Path) -> None:
    asked = "observer: {family: auto, objective: max_period, rate_at_least: 0.5}"
    result = made(tmp_path, text(asked, A="1"), ("synthesize", "check"))
    told, design = rows(result), result.design
    assert design is not None
    tried = {name: float(row["period"]) for name, row in told.items() if row["verdict"] == "proved"}
    assert len(tried) == 2 and tried[design["family"]] == max(tried.values())
    assert told[design["family"]]["why"] == "chosen: proved, with the longest period"


def test_an_objective_that_a_family_does_not_have_leaves_it_out(tmp_path: Path) -> None:
    asked = "observer: {family: auto, objective: decay_rate}"
    told = rows(made(tmp_path, text(asked, start="initial_box: {lower: [0], upper: [1]}"), ("synthesize",)))
    assert told["interval"]["why"] == "it has no objective decay_rate"
    asked = "observer: {family: auto, rate_at_least: 1}"
    told = rows(made(tmp_path, text(asked, start="initial_box: {lower: [0], upper: [1]}"), ("synthesize",)))
    assert told["interval"]["why"] == "it has no rate_at_least"


def test_where_no_family_finds_a_design_the_reason_is_told(tmp_path: Path) -> None:
    """An unstable state that no output sees."""
    unseen = text(A="1").replace("C: [[1]]", "C: [[0]]")
    result = made(tmp_path, unseen, ("synthesize", "check"))
    assert result.design is not None and result.design["outcome"] == "none" and result.status == "finding"
    assert "no family found a design" in rows(result)[result.design["family"]]["why"]


def test_no_clock_decides_size_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(choice, "MAX_SIZE", 0)
    result = made(tmp_path, text(), ("synthesize",))
    told = rows(result)
    assert told["reachability"]["why"] == "chosen: the first of those that are too large to be tried"
    assert told["lpv_zoh"]["why"].startswith("too large to be tried (1 numbers, at most 0)")
    assert result.design is not None and result.design["outcome"] == "found"


def test_the_best_is_designed_at_the_effort_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, int]] = []
    designed = choice.new_design

    def noted(spec, effort):
        asked.append((spec.observer.name, effort))
        return designed(spec, effort)

    monkeypatch.setattr(choice, "new_design", noted)
    made(tmp_path, text(), ("synthesize",), effort=1)
    assert asked == [("reachability", 0), ("lpv_zoh", 0), ("reachability", 1)]


def trial(name: str, *, outcome: str = "found", verdict: str = "proved", period: str = "1", rate: str | None = None):
    return Trial(name, outcome, verdict, period, rate)


@pytest.mark.parametrize(
    ("trials", "objective", "best"),
    [
        ([trial("a", rate="1"), trial("b", rate="2")], "given_period", "b"),
        ([trial("a", rate="1"), trial("b", rate="inf")], "given_period", "b"),
        ([trial("a", rate="1"), trial("b", rate="1", period="2")], "given_period", "b"),
        ([trial("a", rate="1"), trial("b", rate="1")], "given_period", "a"),
        ([trial("a", rate="9", verdict="undecided"), trial("b", rate="1")], "given_period", "b"),
        ([trial("a", verdict="undecided"), trial("b", verdict="undecided", period="3")], "given_period", "b"),
        (
            [trial("a", outcome="none", verdict="undecided", period="9"), trial("b", verdict="refuted")],
            "given_period",
            "b",
        ),
        ([trial("a", rate="1", period="3"), trial("b", rate="5", period="2")], "max_period", "a"),
        ([trial("a", rate="1", period="3"), trial("b", rate="5", period="2")], "decay_rate", "b"),
    ],
)
def test_the_order(trials: list[Trial], objective: str, best: str) -> None:
    assert max(trials, key=lambda one: one.merit(objective)).family == best


@pytest.mark.parametrize(
    ("observer", "told"),
    [
        ("observer: {family: auto, gain: {K: [[1]]}}", "observer.gain: unknown key"),
        ("observer: {family: auto, objective: min_width}", "observer.objective: one of a few values is expected"),
        ("observer: {family: auto, rate_at_least: -1}", "observer.rate_at_least: a number that is not negative"),
        ("observer: {family: aut}", "observer.family: unknown family"),
        ("observer: {objective: max_period}", "observer.family: is required"),
        ("observer: 3", "observer: a mapping is expected"),
    ],
)
def test_wrong_blocks_are_told(tmp_path: Path, observer: str, told: str) -> None:
    (tmp_path / "s.yaml").write_text(text(observer))
    with pytest.raises(SpecError, match=re.escape(told)) as caught:
        load(tmp_path / "s.yaml")
    assert all(problem.line == 4 for problem in caught.value.problems)


def test_a_plant_that_no_family_takes_is_told_with_every_reason(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(text(law="updated: true").replace("C: [[1]]", "C: [[1], [2]]"))
    with pytest.raises(SpecError, match="no family takes this plant and its sampling") as caught:
        load(tmp_path / "s.yaml")
    assert all(f"{name}: " in str(caught.value) for name in FAMILIES)


def test_the_example_runs_as_it_is(tmp_path: Path) -> None:
    result = made(tmp_path, example())
    assert result.status == "ok" and result.check is not None and result.check["verdict"] == "proved"
    assert (tmp_path / "out" / "report.html").is_file()


def test_a_period_that_is_no_decimal_is_compared() -> None:
    """The law's own period is stored as typed: 1/3, sqrt(2)/4."""
    third, less = (Trial(name, "found", "proved", period=text) for name, text in (("a", "1/3"), ("b", "0.33")))
    assert third.merit("max_period") > less.merit("max_period")
