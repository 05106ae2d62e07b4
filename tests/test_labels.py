"""Labels of units: everywhere where a time or a state is shown, nowhere where something is computed."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from command import made

from cdobs_cli.certificate import Bound, Check, Claim
from cdobs_cli.chart import Chart, Panel
from cdobs_cli.errors import SpecError
from cdobs_cli.labels import Labels
from cdobs_cli.outcome import Result
from cdobs_cli.spec.model import load

SPEC = """\
spec_version: 1
title: Pendulum
plant:
  states: [theta, omega]
  A: [[0, 1], [0, 0]]
  phi: ["0", "sin(theta)"]
  lipschitz: [[0, 0], [1, 0]]
  domain: {theta: [-0.5, 9]}
measurement: {C: [[1, 0]], sampling: {period: 0.6}}
observer: {family: reachability, gain: {K: [[1], ["1.8361"]]}}
simulation: {horizon: 6, initial_state: [0.4, -1], initial_estimate: [0, 0]}
"""
LABELLED = SPEC.replace("  states: [theta, omega]", "  time_unit: min\n  states: {theta: rad, omega: rad/min}")
assert LABELLED != SPEC


@pytest.fixture(scope="module")
def labelled(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    folder = tmp_path_factory.mktemp("labels")
    return folder, made(folder, LABELLED)


def test_every_bound_bears_the_unit_of_time(labelled: tuple[Path, Result]) -> None:
    check = json.loads((labelled[0] / "out" / "check.json").read_text())
    units = {bound["unit"] for bound in check["bounds"].values()}
    assert units and units <= {"min", "1/min"}
    assert check["bounds"]["period_max"]["unit"] == "min"


def test_every_page_and_line_bears_it(labelled: tuple[Path, Result]) -> None:
    folder, told = labelled
    text, page = ((folder / "out" / name).read_text() for name in ("report.md", "report.html"))
    for shown in (text, page):
        assert "every 0.6 min" in shown and "shortest period (min)" in shown and "time in min" in shown
        shown = re.sub("<math><mi>([θω])</mi></math>", r"\1", shown)
        assert "θ in rad, ω in rad/min" in shown
        assert re.search(r"θ 0\.\d+ rad, ω", shown)
        assert re.search(r"sampling every 0\.6 min", shown)
        assert re.search(r"θ leaves the domain at t = [\d.]+ min: .* beyond it \(rad\)", shown)
        assert not re.search(r"\d s\b|\((1/)?s\)", re.sub(r"<(svg|style|script)\b.*?</\1>", "", shown, flags=re.DOTALL))
    assert any("min" in line and "sampling" in line for line in told.summary)
    assert " min" in told.headline and not any(re.search(r"\d s\b", line) for line in (*told.summary, told.headline))
    assert any("min: " in message.text for message in told.messages)


def test_every_axis_bears_it(labelled: tuple[Path, Result]) -> None:
    csv = (labelled[0] / "out" / "figures" / "states.csv").read_text()
    assert "(rad)" in csv and "(rad/min)" in csv and "(s)" not in csv
    panel = Panel("time (s)", r"$\theta$", (), "linear")
    shown = Labels("min", {"theta": "rad"}).chart(Chart("a", "", "", (panel,)), {panel.y_label: "theta"}).panels[0]
    assert (shown.x_label, shown.y_label) == ("time (min)", r"$\theta$ (rad)")
    periods = (labelled[0] / "out" / "figures" / "periods.csv").read_text()
    assert "(s)" not in periods


def test_labels_cost_nothing_and_numbers_stay(tmp_path: Path) -> None:
    made(tmp_path, SPEC)
    folder = tmp_path / "out"
    names = ("design.json", "simulation.json", "simulation.npz")
    before = {name: ((folder / name).stat().st_mtime_ns, (folder / name).read_bytes()) for name in names}
    plain = json.loads((folder / "check.json").read_text())
    made(tmp_path, LABELLED)
    assert {name: ((folder / name).stat().st_mtime_ns, (folder / name).read_bytes()) for name in names} == before
    other = json.loads((folder / "check.json").read_text())
    assert other["time_unit"] == "min" and "time_unit" not in plain
    assert other["claims"] == plain["claims"] and other["digests"]["key"] == plain["digests"]["key"]
    assert {name: bound | {"unit": ""} for name, bound in other["bounds"].items()} == {
        name: bound | {"unit": ""} for name, bound in plain["bounds"].items()
    }
    assert "every 0.6 min" in (folder / "report.md").read_text()
    made(tmp_path, SPEC)
    assert json.loads((folder / "check.json").read_text()) == plain
    made(tmp_path, LABELLED.replace("time_unit: min", "time_unit: h"), ("report",))
    assert "every 0.6 h" in (folder / "report.md").read_text()


def test_a_label_is_no_part_of_a_key(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(SPEC)
    (tmp_path / "b.yaml").write_text(LABELLED)
    assert load(tmp_path / "a.yaml").normalised() == load(tmp_path / "b.yaml").normalised()
    assert load(tmp_path / "b.yaml").labels == Labels("min", {"theta": "rad", "omega": "rad/min"})
    assert load(tmp_path / "a.yaml").labels == Labels()


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("min\n", '"$x$"\n', "plant.time_unit: a label of a unit is up to 16 letters"),
        ("min\n", "[1]\n", "plant.time_unit: text is expected"),
        ("min\n", '"a very long unit of time"\n', "plant.time_unit: a label of a unit"),
        ("min\n", '" "\n', "plant.time_unit: a label of a unit"),
        ("theta: rad,", 'theta: "<b>",', "plant.states.theta: a label of a unit"),
        ("theta: rad,", "theta: [rad],", "plant.states.theta: text is expected"),
        ("theta: rad,", "theta: 3,", "plant.states.theta: text is expected"),
        ("theta: rad,", "1theta: rad,", "plant.states: a name is a letter"),
        ("theta: rad,", "sin: rad,", "plant.states: the name sin is reserved"),
        ("{theta: rad, omega: rad/min}", "{}", "plant.states: a list of 1 to 32 entries is expected"),
    ],
)
def test_wrong_labels_are_told(tmp_path: Path, old: str, new: str, told: str) -> None:
    assert LABELLED.count(old) == 1
    (tmp_path / "s.yaml").write_text(LABELLED.replace(old, new))
    with pytest.raises(SpecError) as caught:
        load(tmp_path / "s.yaml")
    assert any(told in str(problem) and problem.line is not None for problem in caught.value.problems), caught.value


@pytest.mark.parametrize("label", ["µs", "°C", "m/s**2", "mol/l", "1/h", "m s^-1", "%"])
def test_usual_labels_are_taken(tmp_path: Path, label: str) -> None:
    (tmp_path / "s.yaml").write_text(LABELLED.replace("theta: rad,", f'theta: "{label}",'))
    assert load(tmp_path / "s.yaml").labels.states["theta"] == label


def test_a_state_may_have_no_label(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(LABELLED.replace("theta: rad,", "theta: null,"))
    assert load(tmp_path / "s.yaml").labels.states == {"omega": "rad/min"}


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("converges, sampling every 0.25.", "converges, sampling every 0.25 h."),
        ("sampling at periods in [0, 1/8], and", "sampling at periods in [0, 1/8] h, and"),
        ("for every T_k in [0.1, 5e-3]", "for every T_k in [0.1, 5e-3] h"),
        ("no gain was found at T = 0.6; more", "no gain was found at T = 0.6 h; more"),
        ("for every slope history", "for every slope history"),
        (
            "words of up to 3 periods; the longest period with a proof is 0.7, whose gain is kept",
            "words of up to 3 periods; the longest period with a proof is 0.7 h, whose gain is kept",
        ),
        ("fails at the constant period 1.25: on each", "fails at the constant period 1.25 h: on each"),
        ("this gain, at the rate 1/8", "this gain, at the rate 1/8 1/h"),
        ("this gain, periods from 0.1", "this gain, periods from 0.1 h"),
        ("for every 2 x 2 matrix of T_k = 3,", "for every 2 x 2 matrix of T_k = 3 h,"),
    ],
)
def test_sentences(text: str, shown: str) -> None:
    assert Labels("h").sentence(text) == shown
    assert Labels().sentence(text) == text


def test_units_of_bounds_come_from_whatever_they_were() -> None:
    bounds = {"period_max": Bound("1"), "decay_rate": Bound("1", unit="1/s"), "final_width": Bound("1", unit="")}
    check = Check((Claim("convergence", "consequence", "proved", "", "", required=True),), bounds)
    first = Labels("min").bounds(check)
    assert [one.unit for one in first.bounds.values()] == ["min", "1/min", ""]
    assert [one.unit for one in Labels("h").bounds(first).bounds.values()] == ["h", "1/h", ""]
    assert Labels().bounds(first) == check
    assert Check.from_document(first.document()) == first


def test_hostile_labels_show_as_text(tmp_path: Path) -> None:
    text = LABELLED.replace("theta: rad,", 'theta: "*a* ^b^",')
    made(tmp_path, text)
    assert r"θ in \*a\* ^b^" in (tmp_path / "out" / "report.md").read_text()
