"""Objectives that mean something: a rate, no period too long, what falls short and why."""

from __future__ import annotations

from dataclasses import replace
from math import exp, log
from pathlib import Path

import pytest

from cdobs_cli.certificate import Certificate, Check
from cdobs_cli.certify.lmi import ran_out
from cdobs_cli.certify.methods.open_loop import OpenLoop
from cdobs_cli.design import Design, SolverRecord
from cdobs_cli.errors import SpecError
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.pipeline import Work, check
from cdobs_cli.spec.model import Spec, load
from cdobs_cli.store import Store

PLANT = """
spec_version: 1
plant: {{states: [{states}], A: {A}, phi: {phi}, lipschitz: {slopes}}}
measurement: {{C: {C}, sampling: {law}}}
observer: {{family: {family}, objective: {objective}{more}}}
"""


def spec(tmp_path: Path, A: str, C: str, law: str, family: str, objective: str, **more: str) -> Spec:
    count = A.count("], [") + 1
    states = ", ".join(f"x{k + 1}" for k in range(count))
    slopes = more.pop("slopes", str([[0] * count] * count))
    phi = more.pop("phi", str(["0"] * count)).replace("'", '"')
    rest = "".join(f", {name}: {value}" for name, value in more.items())
    path = tmp_path / "spec.yaml"
    path.write_text(
        PLANT.format(
            states=states, A=A, phi=phi, slopes=slopes, C=C, law=law, family=family, objective=objective, more=rest
        )
    )
    return load(path)


def run(one: Spec, tmp_path: Path, effort: int = 1) -> tuple[Design, Check]:
    work = Work(one, Store(tmp_path / "results"), effort=effort)
    made = check(work)
    assert work.design is not None
    return work.design, made


@pytest.mark.parametrize("family", ["lpv_zoh", "reachability"])
def test_a_plant_that_is_stable_by_itself_needs_no_sample(family: str, tmp_path: Path) -> None:
    """x' = -x decays at rate 1: no period is too long; the design is the best one for the law that was typed."""
    design, made = run(spec(tmp_path, "[[-1]]", "[[1]]", "{max_period: 0.1}", family, "max_period"), tmp_path)
    assert design.sampling.T_max == Exact("0.1") and made.verdict == "proved"
    assert made.bounds["period_max_any_gain"].proved == "inf"
    stored = next(one for one in design.certificates if one.method == OpenLoop.name)
    assert float(Exact(stored.data["sigma"])) == pytest.approx(log(100) / (50 * 0.1), rel=1e-3)
    assert float(made.bounds["decay_rate"].proved or 0) > float(Exact(stored.data["sigma"]))


def test_a_rate_beyond_the_plants_own_ends_the_period(tmp_path: Path) -> None:
    """x' = -x with the hold at rate 2 needs samples: L = 1 gives e- = (2 exp(-T) - 1) e, so the period is bounded."""
    one = spec(tmp_path, "[[-1]]", "[[1]]", "{max_period: 0.1}", "lpv_zoh", "max_period", rate_at_least="2")
    design, made = run(one, tmp_path)
    T, at_rate = float(design.sampling.T_max), made.bounds["period_max_at_rate"]
    assert float(at_rate.proved or 0) >= 0.1 and float(at_rate.proved or 0) <= T * (1 + 1e-9)
    assert made.bounds["period_max_any_gain"].proved != "inf"
    L = float(design.gain["L"][0, 0])
    factor = abs(exp(-T) - L * (1 - exp(-T)))
    assert factor <= exp(-2 * T) * (1 + 1e-9)


def test_a_chain_without_slopes_has_a_gain_for_every_period(tmp_path: Path) -> None:
    one = spec(tmp_path, "[[0, 1], [0, 0]]", "[[1, 0]]", "{period: 0.1}", "reachability", "max_period")
    design, made = run(one, tmp_path)
    assert design.sampling.T_max == Exact("0.1") and made.verdict == "proved"
    assert made.bounds["period_max_any_gain"].proved == "inf"
    unseen = spec(tmp_path, "[[0, 1], [0, 0]]", "[[0, 1]]", "{period: 0.1}", "reachability", "max_period")
    assert run(unseen, tmp_path)[1].bounds["period_max_any_gain"].proved is None


def test_a_rate_of_the_star_tracker_and_its_refuted_end(tmp_path: Path) -> None:
    """[0.25, 4] s, A = [[0, -1], [0, 0]]: K = (1, -0.317) has 0.329; a grid of 1/64 gave 0.265625."""
    law = "{min_period: 0.25, max_period: 4}"
    one = spec(tmp_path, "[[0, -1], [0, 0]]", "[[1, 0]]", law, "reachability", "decay_rate")
    bound = run(one, tmp_path)[1].bounds["decay_rate"]
    assert 0.32 <= float(bound.proved or 0) <= float(bound.refuted or 0) < 0.36


def test_what_falls_short_is_kept_and_says_why(tmp_path: Path) -> None:
    one = spec(
        tmp_path, "[[0, 1], [0, 0]]", "[[1, 0]]", "{max_period: 3}", "lpv_zoh", "given_period",
        phi="['0', 'sin(x1)']", slopes="[[0, 0], [1, 0]]",
    )  # fmt: skip
    design, made = run(one, tmp_path, 0)
    assert design.outcome == "short" and design.sampling.T_max == Exact("3") and made.verdict != "proved"
    assert 0.5 < float(made.bounds["period_max"].proved or 0) < 2
    assert "the longest period met with a proof" in (design.reason or "")
    convergence = made.claim("convergence")
    assert convergence is not None and (made.verdict == "refuted" or (design.reason or "") in convergence.statement)


def test_an_undetectable_corner_is_told_in_the_names_of_the_states(tmp_path: Path) -> None:
    """x2 is not seen where its slope in the first row reaches 0, and it does not decay."""
    one = spec(
        tmp_path, "[[-1, 0], [0, 0.1]]", "[[1, 0]]", "{period: 0.5}", "lpv_zoh", "given_period",
        phi="['0.5*sin(x2)', '0']", slopes="[[0, [0, 0.5]], [0, 0]]",
    )  # fmt: skip
    design, made = run(one, tmp_path, 0)
    assert design.outcome == "none" and made.verdict != "proved"
    assert "x2" in (design.reason or "") and "detectable" in (design.reason or "")


def test_an_edited_open_loop_is_not_believed(tmp_path: Path) -> None:
    one = spec(tmp_path, "[[-1]]", "[[1]]", "{max_period: 0.1}", "lpv_zoh", "max_period")
    design, _ = run(one, tmp_path)

    def bound(sigma: str, P: str) -> str | None:
        edited = Certificate(OpenLoop.name, design.sampling, {"sigma": sigma, "P": [[P]]})
        others = tuple(c for c in design.certificates if c.method != OpenLoop.name)
        judged = one.observer.certify(one.plant, replace(design, certificates=(*others, edited)), 0)
        return judged.bounds["period_max_any_gain"].proved

    assert bound("0.99", "1") == "inf"
    assert bound("1.01", "1") != "inf" and bound("0.9", "-1") != "inf"


@pytest.mark.parametrize("objective", ["given_period", "decay_rate"])
def test_a_rate_to_be_kept_belongs_to_the_longest_period(objective: str, tmp_path: Path) -> None:
    with pytest.raises(SpecError, match="objective: max_period"):
        spec(tmp_path, "[[-1]]", "[[1]]", "{max_period: 0.1}", "lpv_zoh", objective, rate_at_least="1")


def test_a_rate_that_no_gain_keeps_is_told_and_the_longest_period_at_any_rate_is_kept(tmp_path: Path) -> None:
    """x2 decays at 1 and no output shows it: the rate 3 is out of reach, and convergence is not."""
    about = (tmp_path, "[[0, 0], [0, -1]]", "[[1, 0]]", "{period: 0.1}", "lpv_zoh", "max_period")
    one = spec(*about, rate_at_least="3")
    design, made = run(one, tmp_path)
    assert design.outcome == "short" and made.verdict == "proved"
    told = "no gain keeps the rate 3: an error along x2 decays at 1 and no output shows it"
    assert design.reason is not None and design.reason.startswith(told)
    assert float(design.sampling.T_max) > 0.1
    kept = spec(
        tmp_path, "[[0, 0], [0, -1]]", "[[1, 0]]", "{period: 0.1}", "lpv_zoh", "max_period", rate_at_least="0.5"
    )
    assert run(kept, tmp_path)[0].outcome == "found"


@pytest.mark.parametrize(("a", "outcome"), [("-1", "found"), ("0", "none")])
def test_the_gain_0_where_the_error_decays_by_itself(a: str, outcome: str, tmp_path: Path) -> None:
    """y = u x with u in [-1, 1] tells x with either sign: no other gain helps at every sample."""
    path = tmp_path / "spec.yaml"
    path.write_text(f"""
spec_version: 1
plant: {{states: [x], inputs: {{u: {{range: [-1, 1]}}}}, dynamics: ["{a}*x"], output: ["u*x"]}}
measurement: {{sampling: {{max_period: 0.1}}}}
observer: {{family: lpv_zoh}}
""")
    design, made = run(load(path), tmp_path)
    assert design.outcome == outcome and (made.verdict == "proved") is (outcome == "found")
    assert outcome == "none" or design.gain["L"].texts() == [["0"]]


def test_a_solver_that_ran_out_is_told() -> None:
    def record(status: str) -> SolverRecord:
        return SolverRecord("clarabel", "1", status, 3)

    assert ran_out([]) is None and ran_out([record("Solved"), record("NumericalError")]) is None
    told = ran_out([record("MaxIterations"), record("Solved"), record("MaxIterations")])
    assert told == "the solver clarabel ran out in 2 of 3 calls (MaxIterations)"
