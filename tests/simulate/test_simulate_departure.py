"""Leaving the domain: which state, when, at which value, in figures, findings and reports."""

from __future__ import annotations

import json
from dataclasses import replace
from math import exp, log
from pathlib import Path

import numpy as np
import pytest
from loops import box, copy_observer, pendulum, periodic, plan, plant, read

from cdobs_cli.batch import Settings, run
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.outcome import STAGES, Job
from cdobs_cli.plant import Domain, Interval
from cdobs_cli.simulate.agreement import agrees
from cdobs_cli.simulate.engine import simulate

GROWS = Domain({"x": Interval(Exact(-1), Exact(1))})


def growing(**further):
    return copy_observer(plant(("x",), [[1]], law=periodic("0.25"), **further), ["1"])


@pytest.mark.parametrize("runs", [1, 3])
def test_the_departure_is_where_the_state_crosses(runs):
    made = simulate(growing(domain=GROWS), plan("2", ["0.5"], ["0.5"], runs=runs), periodic("0.25"))
    for one in (*made.summaries, made.overall):
        assert one.left_domain and one.departure is not None
        assert (one.departure.what, one.departure.allowed) == ("x", "-1 to 1")
        assert one.departure.time == pytest.approx(log(2), abs=0.01) and one.departure.time >= log(2)
        assert one.departure.value == pytest.approx(0.5 * exp(one.departure.time), rel=1e-9)
        assert one.departure.beyond == pytest.approx(0.5 * exp(2) - 1, rel=1e-9)


def test_what_stays_has_no_departure():
    made = simulate(growing(domain=GROWS), plan("0.69", ["0.5"], ["0.5"]), periodic("0.25"))
    assert made.overall.departure is None and not made.overall.left_domain
    assert simulate(growing(), plan("2", [1], [1]), periodic("0.25")).overall.departure is None


def test_the_earliest_run_stands_for_all():
    made = simulate(growing(domain=GROWS), plan("2", None, ["0"], runs=6, initial_box=box(["-0.9"], ["0.9"])),
                    periodic("0.25"))  # fmt: skip
    times = [one.departure.time for one in made.summaries if one.departure is not None]
    assert len(times) > 1
    assert made.overall.departure.time == min(times)


def test_the_estimate_and_a_condition_are_named():
    domain = Domain({"theta": Interval(Exact(-1), Exact("1.5"))})
    made = simulate(pendulum(domain=domain), plan("1", [0, 0], [2, 0]), periodic("0.6"))
    assert (made.overall.departure.what, made.overall.departure.time) == ("the estimate of theta", 0.0)
    where = Domain(where=(read("0.5 - theta", ["theta"]),))
    made = simulate(pendulum(domain=where), plan("20", ["0.4", "0.5"], ["0.4", "0.5"]), periodic("0.6"))
    departure = made.overall.departure
    assert departure.what == "0.5 - theta" and departure.value < 0 and departure.allowed == "at least 0"


def test_one_run_and_many_tell_the_same():
    one, many = (
        simulate(growing(domain=GROWS), plan("2", ["0.5"], ["0.5"], runs=runs), periodic("0.25")).overall.departure
        for runs in (1, 2)
    )
    assert one.what == many.what and one.beyond == pytest.approx(many.beyond, rel=1e-8)


def test_a_stored_departure_that_the_run_does_not_show_is_seen():
    system = growing(domain=GROWS)
    made = simulate(system, plan("2", ["0.5"], ["0.5"]), periodic("0.25"))
    assert agrees(made, system)
    told = made.overall
    for departure, left in (
        (None, False),
        (None, True),
        (told.departure, False),
        (replace(told.departure, what="y"), True),
        (replace(told.departure, time=1.5), True),
        (replace(told.departure, allowed="-9 to 9"), True),
        (replace(told.departure, beyond=-1.0), True),
    ):
        other = replace(told, departure=departure, left_domain=left)
        assert not agrees(replace(made, summaries=(other,), overall=other), system)


SPEC = """\
spec_version: 1
plant:
  states: [x]
  dynamics: ["x"]
  output: ["x"]
  domain: {x: [-1, 1]}
  COORDINATES
measurement: {sampling: {period: 0.25}}
observer: {family: lpv_zoh, gain: {L: [["2.5"]]}}
simulation: {horizon: 2, initial_state: [0.5], initial_estimate: [0.5]}
"""


@pytest.mark.parametrize("coordinates", ["", 'coordinates: {map: ["2*x"], inverse: ["x1/2"]}'])
def test_finding_and_report_say_which_state_when_and_by_how_much(tmp_path: Path, coordinates: str) -> None:
    """In the user's own states, whatever coordinates the plant is in."""
    (tmp_path / "s.yaml").write_text(SPEC.replace("COORDINATES", coordinates))
    made = run(Job(tmp_path / "s.yaml", tmp_path / "out"), STAGES, Settings(out=tmp_path, effort=0))
    (told,) = [one.text for one in made.messages if one.rule == "simulation.left_domain"]
    assert told.startswith("x leaves the domain at t = 0.69") and "allowed -1 to 1; at most 2.69453 beyond it" in told
    assert made.simulation is not None
    departure = made.simulation["runs"][0]["departure"]
    assert departure["what"] == "x" and np.isclose(departure["value"], 0.5 * exp(departure["time"]))
    assert f"{told}." in (tmp_path / "out" / "report.md").read_text()
    assert json.loads((tmp_path / "out" / "simulation.json").read_text())["overall"]["departure"] == departure
