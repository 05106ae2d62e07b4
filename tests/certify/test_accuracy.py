"""From a spec with noise to its bounds of the error, their claims, and the verdict."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command import made
from designing import designed
from noisy_examples import noisy, pendulum

from cdobs_cli.certificate import Check
from cdobs_cli.certify import lmi
from cdobs_cli.certify.accuracy import acting_text
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.pipeline import Work, replay
from cdobs_cli.plant import Box, Plant
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.spec.model import load
from cdobs_cli.store import Store

SPEC = """\
spec_version: 1
plant:
  states: {{theta: rad, omega: rad/s}}
  A: [[0, 1], [0, 0]]
  phi: ["0", "{phi}"]
  lipschitz: {slopes}
  disturbance: {{lower: [0, -0.05], upper: [0, 0.05]}}
  {domain}
measurement: {{C: [[1, 0]], sampling: {{{law}}}, noise: {{lower: [-0.01], upper: [0.01]}}}}
observer: {{family: {family}, gain: {gain}{more}}}
simulation: {{horizon: 10, initial_state: [0.2, 0.1], initial_estimate: [0, 0]}}
"""


def spec(**parts: str) -> str:
    filled = {
        "phi": "sin(theta)", "slopes": "[[0, 0], [1, 0]]", "domain": "", "law": "period: 0.6",
        "family": "reachability", "gain": "{K: [[1], [1.47478]]}", "more": "",
    } | parts  # fmt: skip
    return SPEC.format(**filled)


def checked(folder: Path, **parts: str) -> tuple[Check, Design]:
    found = made(folder, spec(**parts), ("synthesize", "check"), effort=1)
    assert found.check is not None and found.design is not None, found.messages
    return Check.from_document(found.check), Design.from_document(found.design)


def test_a_spec_with_noise_has_bounds_claims_and_counterexamples(tmp_path: Path) -> None:
    check, design = checked(tmp_path)
    assert check.verdict == "proved"
    assert {one.method for one in design.certificates} >= {"peak"}
    bounded = check.claim("error_bounded")
    assert bounded.required and bounded.kind == "consequence" and bounded.status == "proved"
    told = "Under |v| <= 0.01, |d_omega| <= 0.05 the error stays bounded: |e_theta| <= 0.05"
    assert bounded.statement.startswith(told)
    assert check.claim("convergence").statement.endswith("sampling every 0.6, without disturbance and noise.")
    for state, unit in (("theta", "rad"), ("omega", "rad/s")):
        bound = check.bounds[f"error.{state}"]
        assert bound.better == "less" and bound.unit == unit and bound.method == "peak"
        assert 0.95 * float(bound.proved) < float(bound.refuted) < float(bound.proved)
        claim, reached = check.claim(f"error.{state}"), check.claim(f"error.{state}.reached")
        assert claim.status == "proved" and f"<= {bound.proved}" in claim.statement
        assert reached.witness.kind == "noise" and bound.refuted in reached.statement
        from_start = check.bounds[f"error_transient.{state}"]
        assert float(from_start.proved) > float(bound.proved)
        assert "from e_theta(0) in [-0.2, -0.2]" in from_start.about


def test_a_check_asks_no_solver_and_a_changed_certificate_proves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    question = pendulum("0.6", ("1", "1.47478"), effort=0)
    card = Reachability.model_validate({"family": "reachability", "gain": {"K": question.gain("K")}})
    design = designed(card, question.plant, 0)

    def refused(*_: Any) -> None:
        raise AssertionError("the solver")

    monkeypatch.setattr(lmi, "ask_clarabel", refused)
    check = card.certify(question.plant, design, 0)
    assert check.verdict == "proved"
    edited = []
    for one in design.certificates:
        data = dict(one.data)
        if one.method == "peak" and data["state"] == "1":
            data["chains"] = [chain | {"rho": "0.2"} for chain in data["chains"]]
        edited.append(replace(one, data=data))
    worse = card.certify(question.plant, replace(design, certificates=tuple(edited)), 0)
    assert worse.verdict == "undecided" and worse.claim("error.x1").status == "undecided"
    assert worse.claim("error_bounded").status == "undecided" and worse.claim("convergence").status == "proved"
    assert worse.bounds["error.x1"].proved is None and worse.bounds["error.x1"].refuted is not None
    assert worse.bounds["error.x0"] == check.bounds["error.x0"]


def test_certificates_of_another_law_are_no_bounds_of_this_one() -> None:
    question = pendulum("0.6", ("1", "1.47478"), effort=0)
    card = Reachability.model_validate({"family": "reachability", "gain": {"K": question.gain("K")}})
    design = designed(card, question.plant, 0)
    other = replace(design, sampling=SamplingLaw.periodic(Exact("0.61")))
    check = card.certify(question.plant, other, 0)
    assert "error.x1" not in check.bounds and check.claim("error_bounded").status == "undecided"


def test_without_noise_nothing_is_said_of_it() -> None:
    question = pendulum("0.6", ("1", "1.47478"), effort=0)
    quiet = noisy(question.plant, None, None)
    card = Reachability.model_validate({"family": "reachability", "gain": {"K": question.gain("K")}})
    design = designed(card, quiet, 0)
    check = card.certify(quiet, design, 0)
    assert not any(one.method.startswith("peak") for one in design.certificates)
    assert check.claim("error_bounded") is None and not any(name.startswith("error") for name in check.bounds)


def test_a_gain_that_diverges_has_no_bound(tmp_path: Path) -> None:
    check, _ = checked(tmp_path, gain="{K: [[-1], [-1.8]]}")
    assert check.verdict == "refuted" and check.claim("error_bounded").status == "undecided"
    assert not any(name.startswith("error") for name in check.bounds)


def test_a_held_innovation_from_zero(tmp_path: Path) -> None:
    check, design = checked(
        tmp_path, family="lpv_zoh", gain="{L: [[1.2], [0.6]]}", law="max_period: 0.5", phi="0.3*sin(theta)",
        slopes="[[0, 0], [0.3, 0]]",
    )  # fmt: skip
    assert check.verdict == "proved" and "peak_from_zero" in {one.method for one in design.certificates}
    for state in ("theta", "omega"):
        bound = check.bounds[f"error.{state}"]
        assert float(bound.refuted) < float(bound.proved) < 2 * float(bound.refuted)


DOMAIN = "domain: {theta: [-1, 1]}"
TIGHT = {"domain": DOMAIN, "phi": "theta**2/4", "slopes": "[[0, 0], [0.51, 0]]"}


def test_a_margin_holds_under_noise_or_says_that_it_does_not(tmp_path: Path) -> None:
    held, design = checked(tmp_path, **TIGHT | {"slopes": "[[0, 0], [0.8, 0]]"}, more=", saturate: false")
    assert design.estimate.way == "margin"
    bounded = held.claim("error_bounded")
    assert bounded.status == "proved", bounded.statement
    assert "while the plant stays in theta in [-1, 1], for initial errors" in bounded.statement
    assert held.bounds["error.omega"].proved is not None
    # No room beyond the domain for what noise adds.
    tight, design = checked(tmp_path, **TIGHT, more=", saturate: false")
    bounded = tight.claim("error_bounded")
    assert bounded.status == "undecided" and "is not proved" in bounded.statement
    assert tight.bounds["error.omega"].proved is None and tight.verdict == "undecided"
    # Continued beyond the box, slopes hold wherever the estimate goes.
    continued, design = checked(tmp_path, **TIGHT)
    assert design.estimate.way == "continuation" and continued.claim("error_bounded").status == "proved"


def test_what_acts_is_told_with_its_ends() -> None:
    plant: Plant = noisy(pendulum("0.6", ("1", "1")).plant, ["1/3", 0], ["0.5"])
    assert acting_text(plant) == "|v| <= 0.5, |d_x0| <= 1/3"
    lopsided = replace(plant, noise=Box((Exact("0.1"),), (Exact("0.5"),)))
    assert acting_text(lopsided) == "v in [0.1, 0.5], |d_x0| <= 1/3"
    white = replace(plant, noise=None, covariance=ExactMatrix([["0.1"]]))
    assert acting_text(white) == "|d_x0| <= 1/3, noise of covariance [[0.1]]"


def test_the_run_of_a_counterexample_is_drawn(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(spec())
    document = replay(Work(load(tmp_path / "s.yaml"), Store(tmp_path / "out"), effort=0), "error.omega.reached")
    assert document["error_measured"] == pytest.approx(float(document["error_proved"]), rel=1e-4)
    name = "witness_error_omega_reached_run"
    assert json.loads((tmp_path / "out" / f"{name}.json").read_text())["state"] == 1
    assert (tmp_path / "out" / "figures" / f"{name}.svg").stat().st_size > 1000


def test_a_certificate_about_no_state_of_the_plant_says_nothing() -> None:
    question = pendulum("0.6", ("1", "1.47478"), effort=0)
    card = Reachability.model_validate({"family": "reachability", "gain": {"K": question.gain("K")}})
    design = designed(card, question.plant, 0)
    edited = [
        replace(one, data={**one.data, "state": state}) if one.method == "peak" else one
        for one in design.certificates for state in ("7", "-1", "x", "pi")
    ]  # fmt: skip
    check = card.certify(question.plant, replace(design, certificates=tuple(edited)), 0)
    assert check.claim("error_bounded").status == "undecided" and check.bounds["error.x1"].proved is None
