"""Plants typed with outputs that are not linear: from the spec to the run of the observer that is proved."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cdobs_cli import pipeline
from cdobs_cli.bounds.slopes import resolve, slope_claims, with_found
from cdobs_cli.errors import SpecError
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.findings import at_hand
from cdobs_cli.plant import Plant
from cdobs_cli.spec.model import load
from cdobs_cli.store import Store
from cdobs_cli.synthesis import is_design_of

SPEC = """\
spec_version: 1
plant:
  states: [x, v]
  inputs: {{u: {{range: [-1, 1]}}}}
  dynamics: ["v", "-sin(x) + u"]
  output: {output}
  {more}
measurement: {{sampling: {sampling}}}
observer: {observer}
simulation:
  horizon: 12
  initial_state: [0.5, 0]
  initial_estimate: {estimate}
  signals: {{u: "0.3*sin(t)"}}
"""
DOMAIN = "domain: {x: [-3, 3], v: [-4, 4]}"


def typed(output: str, more: str = "", **fields: str) -> str:
    defaults = {"sampling": "{period: 0.3}", "observer": "{family: reachability}", "estimate": "[0, 0.4]"}
    return SPEC.format(output=output, more=more, **{**defaults, **fields})


def spec_of(folder: Path, text: str) -> Any:
    (folder / "p.yaml").write_text(text)
    return load(folder / "p.yaml")


def work_of(folder: Path, text: str, effort: int = 0) -> pipeline.Work:
    return pipeline.Work(spec_of(folder, text), Store(folder / "p"), effort=effort)


def plant_of(folder: Path, output: str, more: str = "") -> Plant:
    return resolve(spec_of(folder, typed(output, more)).plant)[0]


def convergence(work: pipeline.Work) -> Any:
    claim = pipeline.check(work).claim("convergence")
    assert claim is not None
    return claim


def test_slopes_that_are_constant_stay_exact_and_the_others_are_found(tmp_path):
    plant = plant_of(tmp_path, '["x + 0.1*sin(x)", "2*v + x/3", "u*v + x"]')
    assert [rho.entry for rho in plant.output_quantities] == [(0, 0), (2, 1)]
    assert plant.C.texts() == [["1", "0"], ["1/3", "2"], ["1", "0"]]
    ends = [(str(rho.lower), str(rho.upper)) for rho in plant.output_quantities]
    assert ends == [("0.9", "1.1"), ("-1", "1")]
    claims = {claim.id: claim.status for claim in slope_claims(plant) if claim.id.startswith("slopes.output")}
    assert claims == {"slopes.output.1.1": "proved", "slopes.output.3.2": "proved"}


@pytest.mark.parametrize(
    ("ends", "status"),
    [
        (("0.9", "1.1"), "proved"),
        (("0.9001", "1.1"), "refuted"),
        (("0.9", "1.0999"), "refuted"),
        (("0", "2"), "proved"),
    ],
)
def test_the_slopes_of_an_output_are_premises_proved_or_refuted_at_a_point(tmp_path, ends, status):
    spec = spec_of(tmp_path, typed('["x + 0.1*sin(x)"]'))
    plant = with_found(spec.plant, {"2.1": ("-1", "1"), "output.1.1": ends})
    claims = {claim.id: claim for claim in slope_claims(plant)}
    claim = claims["slopes.output.1.1"]
    assert (claim.status, claim.required) == (status, True)
    assert (claim.witness is None) == (status == "proved")


@pytest.mark.parametrize(
    ("output", "observer"),
    [
        ('["x + u - 2"]', "{family: reachability}"),
        ('["x + 0.2*u**2"]', "{family: lpv_zoh, method: wirtinger}"),
        ('["x + 0.1*abs(x - u)"]', "{family: reachability}"),
        ('["x + 0.1*sin(x + u)"]', "{family: lpv_zoh}"),
    ],
)
def test_what_is_known_of_an_output_is_subtracted(tmp_path, output, observer):
    """An estimate that starts at the state stays there, whatever the input; another one comes to it."""
    work = work_of(tmp_path, typed(output, observer=observer, estimate="[0.5, 0]"))
    assert convergence(work).status == "proved"
    exact = pipeline.simulate(work)
    assert exact is not None and exact["overall"]["error_final"] < 1e-9
    other = work_of(tmp_path, typed(output, observer=observer, sampling="{period: 0.2}"))
    met = pipeline.simulate(other)
    assert met is not None and not met["overall"]["diverged"] and met["overall"]["error_final"] < 0.2


def test_the_observer_measures_and_estimates_the_typed_function(tmp_path):
    work = work_of(tmp_path, typed('["x + 0.1*x**3", "exp(v/10) + u"]', DOMAIN))
    assert convergence(work).status == "proved"
    pipeline.simulate(work)
    assert work.run is not None
    (run,) = work.run.trajectories
    after = np.searchsorted(run.t, run.t_k, side="right") - 1
    x, v, u = run.x[after, 0], run.x[after, 1], 0.3 * np.sin(run.t_k)
    assert run.y_k == pytest.approx(np.stack([x + 0.1 * x**3, np.exp(v / 10) + u], axis=1), abs=1e-9)


def test_outside_the_domain_the_observers_output_keeps_its_slopes(tmp_path):
    """h is continued as phi is: secants from any estimate to the domain lie in the slope box, along a diagonal path."""
    plant = plant_of(tmp_path, '["x + 0.1*x**3 + 0.05*v**2"]', "domain: {x: [-2, 2], v: [-3, 3]}")
    assert plant.h is not None
    continued = plant.continued()
    assert continued.h is not None
    h = compile_floats(continued.h, plant.states, arrays=False)
    typed_h = compile_floats(plant.h, plant.states, arrays=False)
    low, high = (np.array([float(getattr(rho, end)) for rho in plant.output_quantities]) for end in ("lower", "upper"))
    assert typed_h(1.5, -2.0) == h(1.5, -2.0)
    random = np.random.default_rng(0)
    beyond = 0
    for _ in range(500):
        x, x_hat = random.uniform((-2, -3), (2, 3)), random.uniform(-20, 20, size=2)
        e = x_hat - x
        least, most = np.minimum(low * e, high * e).sum(), np.maximum(low * e, high * e).sum()
        difference = h(*x_hat)[0] - h(*x)[0]
        assert least - 1e-9 <= difference <= most + 1e-9
        beyond += not least - 1e-9 <= typed_h(*x_hat)[0] - h(*x)[0] <= most + 1e-9
    assert beyond > 100


@pytest.mark.parametrize(("saturate", "proved"), [("true", True), ("false", False)])
def test_an_estimate_that_may_leave_the_slopes_of_an_output_is_no_proof(tmp_path, saturate, proved):
    observer = f"{{family: reachability, saturate: {saturate}}}"
    # phi alone has its slopes everywhere: only the output needs the domain.
    work = work_of(tmp_path, typed('["x + 0.1*x**3"]', "domain: {x: [-1, 1]}", observer=observer, estimate="[40, 40]"))
    claim = convergence(work)
    assert (claim.status == "proved") == proved
    assert work.design is not None and work.design.estimate.way == ("continuation" if proved else "open")


def test_a_margin_holds_for_the_slopes_of_an_output_too(tmp_path):
    work = work_of(tmp_path, typed('["x + 0.01*x**3"]', DOMAIN, observer="{family: reachability, saturate: false}"))
    assert convergence(work).status == "proved"
    assert work.design is not None and work.design.estimate.way == "margin"
    estimate = pipeline.check(work).claim("estimate")
    assert estimate is not None and estimate.status == "proved"
    low, high = work.design.slopes["output.1.1"]
    assert float(high) > 1 + 0.03 * 9  # found over more than the domain
    plant = with_found(work.spec.plant, {**work.design.slopes, "output.1.1": (low, "1.2701")})
    tight = replace(work.design, slopes={**work.design.slopes, "output.1.1": (low, "1.2701")})
    from cdobs_cli.bounds.estimate import confinement_claim

    transients = work.spec.observer.transients(plant, tight)
    assert transients and confinement_claim(plant, tight.estimate, transients).status == "undecided"


@pytest.mark.parametrize(("output", "about"), [('["x + 0.5*sin(x)"]', "class"), ('["x + u"]', "plant")])
def test_a_refutation_from_slopes_of_the_output_alone_is_about_the_class(tmp_path, output, about):
    """A flow that is linear: without slopes of the output the class is the plant itself."""
    gain = "{family: reachability, gain: {K: [[1.5], [1]]}}"
    work = work_of(tmp_path, typed(output, observer=gain, sampling="{period: 2.5}").replace("-sin(x)", "x"), effort=1)
    claim = convergence(work)
    assert claim.status == "refuted" and claim.witness is not None and claim.witness.about == about
    assert ("the plant as typed may still converge" in claim.statement) == (about == "class")


def test_a_flat_output_is_refuted_with_its_slope(tmp_path):
    claim = convergence(work_of(tmp_path, typed('["x**2"]', "domain: {x: [-1, 1]}")))
    assert claim.status == "refuted" and "d y_1 / d x = 0" in claim.statement
    assert claim.witness is not None and claim.witness.data["outputs"] == [{"entry": [0, 0], "values": ["0"]}]


@pytest.mark.parametrize(
    ("output", "more", "told"),
    [
        ('["x**3"]', "", "no bound of d y_1/d x = 3 * x**2 was proved; declare a smaller domain of x"),
        ('["sqrt(x)"]', "domain: {x: [-1, 1]}", "no bound of d y_1/d x"),
    ],
)
def test_slopes_without_a_bound_are_told_at_the_output(tmp_path, output, more, told):
    work = work_of(tmp_path, typed(output, more))
    pipeline.check(work)
    (claim,) = [one for one in pipeline.check(work).claims if one.id.startswith("slopes.output")]
    assert claim.status == "undecided" and told in claim.statement
    assert list(at_hand(work.spec, pipeline.documents(work))) == []
    from cdobs_cli.findings import _place  # the line that a finding is shown at

    assert _place(work.spec, claim.id) == ("plant", "output", 0)


@pytest.mark.parametrize(
    ("text", "field", "told"),
    [
        (typed('["sin(x)"]', observer="{family: reachability, method: set}"), "observer.method", "linear in the"),
        (typed('["sin(x)"]', observer="{family: lpv_zoh, method: wirtinger}"), "observer.method", "linear in the"),
        (typed('["x + u"]', observer="{family: interval}"), "plant.output[0]", "linear in the states"),
        (
            typed('["sin(x)"]', observer="{family: updated_sampling}", sampling="{updated: true}"),
            "plant.output[0]", "linear in the states",
        ),
        (typed('["x + u"]', "coordinates: lie"), "plant.output[0]", "holds no input"),
        (typed('["x + w"]'), "plant.output[0]", "w"),
    ],
)  # fmt: skip
def test_what_takes_linear_outputs_only_says_so(tmp_path, text, field, told):
    with pytest.raises(SpecError) as error:
        spec_of(tmp_path, text)
    by_field = {problem.path: problem for problem in error.value.problems}
    assert field in by_field and told in str(by_field[field])


def test_a_printed_C_goes_with_linear_outputs_only(tmp_path):
    text = typed('["sin(x)"]').replace("measurement: {", "measurement: {C: [[1, 0]], ")
    with pytest.raises(SpecError, match="is not that of `output`"):
        spec_of(tmp_path, text)
    assert spec_of(tmp_path, typed('["x"]').replace("measurement: {", "measurement: {C: [[1, 0]], ")).plant.h is None


@pytest.mark.parametrize("observer", ["{family: reachability}", "{family: lpv_zoh}"])
def test_artefacts_come_back_as_they_were_written_and_belong_to_their_output(tmp_path, observer):
    text = typed('["x + 0.1*sin(x)"]', observer=observer)
    first = work_of(tmp_path, text)
    assert convergence(first).status == "proved" and pipeline.simulate(first) is not None
    again = work_of(tmp_path, text)
    assert convergence(again).status == "proved" and pipeline.simulate(again) == first.simulation
    assert not again.redone
    stored = Store(tmp_path / "p").design()
    assert stored is not None and stored.slopes["output.1.1"] == ("0.9", "1.1")
    assert is_design_of(first.spec, stored)
    del (lost := dict(stored.slopes))["output.1.1"]
    assert not is_design_of(first.spec, replace(stored, slopes=lost))
    other = spec_of(tmp_path, typed('["x"]', observer=observer))
    assert not is_design_of(other, stored)
    assert convergence(work_of(tmp_path, typed('["x + 0.3*sin(x)"]', observer=observer))).by is not None


def test_bounds_that_are_too_narrow_in_a_design_are_not_believed(tmp_path):
    work = work_of(tmp_path, typed('["x + 0.1*sin(x)"]'))
    design = pipeline.synthesize(work)
    narrow = replace(design, slopes={**design.slopes, "output.1.1": ("0.95", "1.05")})
    work.design = narrow
    check = pipeline.check(work)
    assert check.claim("slopes.output.1.1").status == "refuted" and check.verdict == "refuted"


def test_a_witness_runs_again_and_the_page_shows_the_slopes_of_the_output(tmp_path):
    gain = "{family: reachability, gain: {K: [[1], [0.85]]}}"
    text = typed('["x + 0.1*sin(x)"]', observer=gain, sampling="{period: 1.45}").replace("-sin(x) + u", "sin(x) + u")
    work = work_of(tmp_path, text, effort=1)
    claim = convergence(work)
    assert claim.status == "refuted" and claim.witness is not None and claim.witness.about == "class"
    again = pipeline.replay(work, "convergence")
    assert again["multiplier_measured"] == pytest.approx(float(again["multiplier_proved"]), rel=1e-6)
    assert json.loads((tmp_path / "p" / "check.json").read_text())["verdict"] == "refuted"
    pipeline.report(work)
    page = (tmp_path / "p" / "report.md").read_text()
    assert "∂y1/∂x" in page and "slopes.output.1.1" in page


RANGE = """\
spec_version: 1
plant:
  states: [x1, x2, v1, v2]
  dynamics: ["v1", "v2", "0", "0"]
  output: ["sqrt(x1**2 + x2**2)", "atan2(x2, x1)"]
  domain: {x1: [8, 12], x2: [-2, 2]}
measurement: {sampling: {period: 0.5}}
observer: {family: reachability}
simulation: {horizon: 15, initial_state: [9, -1, 0.1, 0.1], initial_estimate: [11, 1, 0, 0]}
"""


def test_range_and_bearing_on_a_box(tmp_path):
    work = work_of(tmp_path, RANGE, effort=1)
    assert convergence(work).status == "proved"
    assert len(work.spec.plant.output_quantities) == 4
    done = pipeline.simulate(work)
    assert done is not None and done["overall"]["error_final"] < 1e-3
    wide = work_of(tmp_path, RANGE.replace("[8, 12]", "[-1, 12]"), effort=0)
    pipeline.check(wide)  # through the origin neither has slopes
    assert (
        wide.design is not None
        and wide.design.outcome == "none"
        and "declare a smaller domain" in str(wide.design.reason)
    )


BATTERY = """\
spec_version: 1
plant:
  states: [z, v1]
  inputs: {i: {range: [-5, 5]}}
  parameters: {Q: 10800, R1: 0.02, C1: 2000, a0: 3.2, a1: 1.8, a2: -2.4, a3: 1.5}
  dynamics: ["-i/Q", "-v1/(R1*C1) + i/C1"]
  output: ["a0 + a1*z + a2*z**2 + a3*z**3 - v1"]
  domain: {z: [0.05, 0.95], v1: [-0.2, 0.2]}
measurement: {sampling: SAMPLING}
observer: {family: reachability}
"""


def test_a_battery_without_coordinates(tmp_path):
    work = work_of(tmp_path, BATTERY.replace("SAMPLING", "{min_period: 1, max_period: 10}"))
    assert convergence(work).status == "proved"
    none = work_of(tmp_path, BATTERY.replace("SAMPLING", "{max_period: 10}"))
    assert convergence(none).status == "undecided" and "give min_period" in convergence(none).statement
    held = BATTERY.replace("SAMPLING", "{max_period: 10}").replace("reachability", "lpv_zoh")
    assert "or use family reachability" in convergence(work_of(tmp_path, held)).statement


def test_units_of_exact_numbers_survive(tmp_path):
    plant = plant_of(tmp_path, '["sqrt(2)*x + 0.1*sin(x)"]')
    (rho,) = plant.output_quantities
    assert rho.lower.is_at_most(Exact("sqrt(2) - 0.1")) and Exact("sqrt(2) + 0.1").is_at_most(rho.upper)
    assert float(rho.upper) - float(rho.lower) < 0.201
