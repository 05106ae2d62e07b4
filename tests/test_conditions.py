"""What a verdict is claimed under stands in its sentence, and the run agrees with it."""

from __future__ import annotations

from pathlib import Path

import pytest
from command import made

from cdobs_cli.outcome import Result

SPEC = """\
spec_version: 1
plant:
  states: [x]
  A: [[{A}]]
  phi: ["{phi}"]
  lipschitz: {slopes}
  {more}
measurement: {{C: [[1]], sampling: {{{law}}}{noise}}}
observer: {{family: {family}, gain: {gain}{options}}}
simulation:
  horizon: 20
  initial_state: [0.9]
  initial_estimate: [0]
  {signals}
"""


def result(folder: Path, **parts: str) -> Result:
    filled = {"A": "0", "phi": "0", "slopes": "[[0]]", "more": "", "law": "period: 0.5", "noise": "",
              "family": "reachability", "gain": "{K: [[0.9]]}", "options": "", "signals": ""} | parts  # fmt: skip
    return made(folder, SPEC.format(**filled), ("synthesize", "check", "simulate"))


def convergence(found: Result) -> dict[str, object]:
    assert found.check is not None
    return next(claim for claim in found.check["claims"] if claim["id"] == "convergence")


@pytest.mark.parametrize("family", ["reachability", "lpv_zoh"])
def test_declared_noise_is_in_the_sentence(tmp_path: Path, family: str) -> None:
    found = result(
        tmp_path, family=family, gain="{K: [[0.5]]}" if family == "reachability" else "{L: [[0.5]]}",
        A="-1", more="disturbance: {lower: [-1], upper: [1]}", noise=", noise: {lower: [-1], upper: [1]}",
        signals='signals: {d: ["1"], v: ["1"]}',
    )  # fmt: skip
    told = str(convergence(found)["statement"])
    assert convergence(found)["status"] == "proved"
    assert "without disturbance and noise" in told
    bounded = next(claim for claim in found.check["claims"] if claim["id"] == "error_bounded")
    assert bounded["status"] == "proved" and str(bounded["statement"]).startswith(
        "Under |v| <= 1, |d_x| <= 1 the error"
    )
    assert found.simulation is not None and found.simulation["overall"]["error_final"] > 0.1


WILD = {"phi": "50*max(x - 1, 0)**2", "more": "domain: {x: [0, 1]}", "gain": "{K: [[1.9]]}"}


def test_an_estimate_that_leaves_the_slopes_proves_nothing(tmp_path: Path) -> None:
    """The jump sends x_hat from 0 to 1.71, where phi blows up."""
    found = result(tmp_path, **WILD, options=", saturate: false")
    assert found.check is not None and found.simulation is not None
    assert found.check["verdict"] == "undecided"
    assert found.check["bounds"].get("period_max", {}).get("proved") is None
    assert found.simulation["overall"]["diverged"]


@pytest.mark.parametrize("options", ["", ", saturate: true", ", saturate: auto"])
def test_the_continued_observer_is_proved_and_run(tmp_path: Path, options: str) -> None:
    found = result(tmp_path, **WILD, options=options)
    assert found.check is not None and found.simulation is not None and found.design is not None
    assert found.design["estimate"]["way"] == "continuation"
    assert found.check["verdict"] == "proved"
    assert not found.simulation["overall"]["diverged"]
    assert found.simulation["overall"]["error_final"] < 0.9**40
    assert not found.simulation["overall"]["left_domain"]


def test_an_assumption_about_the_plant_is_named(tmp_path: Path) -> None:
    """x' = -sqrt(max(-x, 0)): the plant may leave [0, 1], the slopes hold there."""
    found = result(tmp_path, phi="-sqrt(max(-x, 0))", more="domain: {x: [0, 1]}")
    assert found.check is not None
    claim = next(claim for claim in found.check["claims"] if claim["id"] == "domain_invariant")
    assert (claim["kind"], claim["status"], claim["required"]) == ("assumption", "undecided", False)
    assert "while the plant stays in x in [0, 1]" in str(convergence(found)["statement"])
    assert found.check["verdict"] == "proved"


def test_an_undefined_phi_is_never_proved(tmp_path: Path) -> None:
    found = result(tmp_path, phi="1/u", more="inputs: {u: {range: [-1, 1]}}", signals='signals: {u: "1"}')
    assert found.check is not None
    assert found.check["verdict"] == "refuted"
    assert next(claim for claim in found.check["claims"] if claim["id"] == "defined")["required"]


def test_a_refutation_says_what_it_is_about(tmp_path: Path) -> None:
    linear = convergence(result(tmp_path, A="1", gain="{K: [[0.1]]}"))
    assert linear["status"] == "refuted" and "the plant as typed" in str(linear["statement"])
    assert linear["witness"]["class"] == "plant"  # type: ignore[index]
    (tmp_path / "b").mkdir()
    slopes = convergence(result(tmp_path / "b", phi="sin(x)", slopes="[[1]]", gain="{K: [[0.1]]}"))
    assert slopes["status"] == "refuted" and "may still converge" in str(slopes["statement"])
    assert slopes["witness"]["class"] == "class"  # type: ignore[index]


def test_slopes_without_a_bound_are_told_at_their_line(tmp_path: Path) -> None:
    found = result(tmp_path, phi="x**2", slopes="auto", gain="{K: [[0.5]]}")
    assert found.status == "finding"
    message = next(message for message in found.messages if message.rule == "slopes.1.1")
    assert message.line == 6
    assert "no bound of d phi_1/d x = 2 * x was proved; declare a smaller domain of x" in message.text


KINKED = """\
spec_version: 1
plant:
  states: [x1, x2]
  A: [[0, 1], [0, 0]]
  phi: ["0", "20*max(0, x1 - 0.1)"]
  lipschitz: {slopes}
  domain: {{x1: [-1, 1], x2: [-1, 1], where: ["x1 <= 0"]}}
measurement: {{C: [[1, 0]], sampling: {{updated: true}}}}
observer: {{family: updated_sampling}}
"""


@pytest.mark.parametrize("slopes", ["auto", "[[0, 0], [0, 0]]"])
def test_slopes_that_only_the_cut_estimate_meets_are_not_forgotten(tmp_path: Path, slopes: str) -> None:
    """x = (-0.3, 0) rests inside the limits; x_hat = (0.9, 0.9) is cut to the box, where the slope is 20."""
    found = made(tmp_path, KINKED.format(slopes=slopes), ("synthesize", "check"))
    assert found.check is not None
    assert found.check["verdict"] == "undecided"
    assert all(bound["proved"] is None for bound in found.check["bounds"].values())


def test_periods_of_a_class_that_is_not_the_plants_are_not_proved_of_it(tmp_path: Path) -> None:
    found = result(
        tmp_path,
        A="-1",
        phi="u*sin(x)",
        slopes="[[1]]",
        more="inputs: {u: {}}",
        gain="{K: [[0.5]]}",
        signals='signals: {u: "0"}',
    )
    assert found.check is not None
    assert found.check["verdict"] == "refuted"
    assert all(
        bound["proved"] is None
        for name, bound in found.check["bounds"].items()
        if name.startswith(("period_max", "decay"))
    )


def test_periods_typed_as_fractions_are_told_as_decimals_below_them(tmp_path: Path) -> None:
    """A margin holds for the typed period, and no further."""
    slopes, domain = "[[[-0.6, 0.6]]]", "domain: {x: [-1, 1]}"
    found = result(
        tmp_path, phi="0.1*x**2", slopes=slopes, more=domain, law='period: "1/3"', options=", saturate: false"
    )
    assert found.check is not None and found.design is not None
    assert found.design["estimate"]["way"] == "margin"
    assert found.check["bounds"]["period_max"]["proved"] == "0.333333333333"
