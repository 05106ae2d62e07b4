"""The verbs of the family: designs, claims, findings, and that a touched design is not proved."""

from dataclasses import replace

import pytest
from interval_plants import PENDULUM_L, PENDULUM_S, PRINTED, box, pendulum, plant, scalar, up_to

from cdobs_cli.certificate import Check
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.families.interval import Feedback, Gain, Interval
from cdobs_cli.run import SimulationPlan
from cdobs_cli.sampling import SamplingLaw

PRINTED_K = Feedback(K_lower=[["-1/8", "-1/8"]], K_upper=[["-1/16", "-1/16"]])


def made(family: Interval, at, effort=1) -> tuple[Design, Check]:
    design = family.synthesize(at, effort)
    design = Design.from_document(design.document())
    check = family.certify(at, design, effort)
    assert Check.from_document(check.document()) == check
    assert [claim.id for claim in check.claims if claim.required] == ["convergence"]
    return design, check


def status(check, claim):
    found = check.claim(claim)
    assert found is not None
    return found.status


def test_the_printed_pendulum():
    _, check = made(Interval(gain=PRINTED, feedback=PRINTED_K), pendulum(up_to("0.1")))
    assert check.verdict == "proved"
    assert {claim.id: claim.status for claim in check.claims} == {
        "assumption_3": "proved", "theorem_1_positivity": "proved", "positivity": "proved", "boundedness": "proved",
        "lmi_15": "proved", "separation": "proved", "theorem_2": "refuted", "convergence": "proved",
    }  # fmt: skip
    width = check.bounds["final_width.x1"]
    assert float(width.refuted) <= 3.8 <= float(width.proved) and float(width.proved) - float(width.refuted) < 1e-9
    assert abs(float(check.bounds["final_width.x2"].proved) - 13.4) < 1e-9


@pytest.mark.parametrize(
    ("T", "verdict", "by"),
    [
        ("0.2879178", "proved", "E(s) >= 0"),
        ("0.2879179", "proved", "cone"),
        ("0.28996", "proved", "cone"),
        ("0.28998", "refuted", "box"),
    ],
)
def test_verdict_turns_at_the_limit_for_boxes_of_x(T, verdict, by):
    """E(s) >= 0 ends at 0.2879178; boxes of x(0) start in a smaller cone, which lasts until sqrt(2) E_11 + E_14 = 0."""
    _, check = made(Interval(gain=PRINTED), pendulum(up_to(T)), 0)
    assert check.verdict == verdict and by in check.claim("positivity").statement
    orthant = check.bounds["positivity_period_max.orthant"]
    assert abs(float(orthant.proved) - 0.2879178) < 1e-7 and abs(float(orthant.refuted) - 0.2879178) < 1e-7
    assert status(check, "theorem_1_positivity") == "refuted"  # the paper's condition says nothing beyond 0.101285


def test_irrational_periods_are_compared_exactly():
    _, check = made(Interval(gain=Gain(S=[[1]], L=[["1.4"]])), scalar(SamplingLaw.periodic(Exact("log(3.5)"))), 0)
    assert check.verdict != "refuted"
    _, check = made(Interval(gain=Gain(S=[[1]], L=[["1.4"]])), scalar(SamplingLaw.periodic(Exact("log(3.6)"))), 0)
    assert check.verdict == "refuted"


def test_period_max_with_given_gains_takes_the_limit():
    design, check = made(Interval(gain=PRINTED, objective="max_period"), pendulum(up_to("0.1")))
    assert check.verdict == "proved" and 0.28996 < float(design.sampling.T_max) < 0.2899707  # E(s) >= 0 until 0.287917
    enclosed = replace(check.bounds["positivity_period_max"], method="positivity and boundedness", about=None)
    assert check.bounds["period_max"] == enclosed


def test_longest_design_of_the_pendulum():
    design, check = made(Interval(objective="max_period"), pendulum(up_to("0.1")))
    assert design.outcome == "found" and check.verdict == "proved"
    assert float(design.sampling.T_max) >= 0.40 and float(check.bounds["period_max"].proved) >= 0.40
    assert float(design.details["sylvester"]["residual"]) < 1e-6
    points = [(float(p["period"]), float(p["width_sum"])) for p in design.details["trade_off"]]
    assert len(points) >= 4 and [w for _, w in sorted(points)] == sorted(w for _, w in points)


def test_narrowest_design_of_the_pendulum():
    design, check = made(Interval(objective="min_width"), pendulum(up_to("0.1")))
    assert check.verdict == "proved" and float(design.sampling.T_max) == 0.1
    assert float(check.bounds["final_width"].proved) <= 17.2 / 3.5


def test_no_period_beyond_reach_is_claimed():
    design, check = made(Interval(), pendulum(up_to("0.5")), 0)
    assert design.outcome == "none" and "0.4" in design.reason and check.verdict == "undecided"


def test_feedback_is_found_and_proved():
    for at in (pendulum(up_to("0.3")), scalar(up_to("0.5"))):
        design, check = made(Interval(feedback="design"), at, 0)
        assert check.verdict == "proved" and status(check, "separation") == "proved", at.states
        assert design.gain["K_lower"] == design.gain["K_upper"]


def test_printed_feedback_of_the_scalar():
    family = Interval(gain=Gain(S=[[1]], L=[["1.4"]]), feedback=Feedback(K_lower=[[-3]], K_upper=[[-3]]))
    _, check = made(family, scalar(up_to("0.35")))
    assert check.verdict == "refuted" and status(check, "positivity") == status(check, "boundedness") == "proved"
    assert "refuted" not in check.claim("convergence").statement  # its status says so
    witness = check.claim("convergence").witness
    assert witness.times == ("0.35",) and abs(float(witness.multiplier) - 1.0953) < 5e-5
    assert abs(float(check.bounds["theorem_2_period_max"].proved) - 0.1934) < 5e-4
    held = check.bounds["held_loop_period_max"]
    assert float(held.proved) < 0.3364722366 < float(held.refuted) and float(held.refuted) - float(held.proved) < 2e-4
    _, check = made(family, scalar(up_to("0.19")))
    assert check.verdict == "proved" and status(check, "theorem_2") == "proved"


@pytest.mark.parametrize("name", ["hurwitz", "lmi_15", "held_loop"])
def test_a_touched_certificate_is_not_believed(name):
    at = pendulum(up_to("0.1"))
    family = Interval(gain=PRINTED, feedback=PRINTED_K)
    design = family.synthesize(at, 0)
    zero = {
        "hurwitz": {"w_star": [["0"], ["0"]]},
        "lmi_15": {"P": [[["0"]]], "W": []},
        "held_loop": {"P": [["0", "0"], ["0", "0"]]},
    }[name]
    touched = tuple(replace(c, data=zero) if c.method.startswith(name) else c for c in design.certificates)
    check = family.certify(at, replace(design, certificates=touched), 0)
    claim = {"hurwitz": "boundedness", "lmi_15": "lmi_15", "held_loop": "separation"}[name]
    assert status(check, claim) == "undecided"
    assert (check.verdict == "proved") == (name == "lmi_15")


def test_a_touched_gain_is_not_proved():
    at = pendulum(up_to("0.1"))
    family = Interval(gain=PRINTED)
    design = family.synthesize(at, 0)
    wrong = replace(design, gain={**design.gain, "L": ExactMatrix([[-4], [4]])})
    assert family.certify(at, wrong, 0).verdict != "proved"


def test_what_is_wrong_is_a_finding_with_its_reason():
    at = pendulum(up_to("0.1"))
    design, check = made(Interval(gain=Gain(S=[[1, 1], [1, 1]], L=[[4], [4]])), at, 0)
    assert design.outcome == "none" and "singular" in design.reason and check.verdict == "undecided"
    design, check = made(Interval(gain=Gain(S=[[1, 0], [0, 1]], L=[[4], [4]])), at, 0)
    assert check.verdict == "refuted" and "(2, 1)" in check.claim("assumption_3").statement
    design, check = made(Interval(), plant([[1, 0], [0, 1]], [[1, 0]], up_to("0.1")), 0)
    assert design.outcome == "none" and "observable" in design.reason
    # T1 and T2 may hold without the paper's structure: reported, but the observer (12) is not claimed
    _, check = made(Interval(gain=Gain(S=[["sqrt(2)", 0], [-1, 1]], L=[[4], ["3.9"]])), at, 0)
    assert status(check, "assumption_3") == "refuted" and status(check, "positivity") == "proved"
    assert check.verdict == "undecided" and "Assumption 3" in check.claim("convergence").statement


def test_hull_needs_no_structure():
    at = pendulum(up_to("0.1"))
    _, check = made(Interval(gain=Gain(S=[["sqrt(2)", 0], [-1, 1]], L=[[4], ["3.9"]]), tighten="hull"), at, 0)
    assert check.verdict == "proved" and status(check, "contraction") == "proved"
    design, check = made(Interval(objective="max_period", tighten="hull"), at, 0)
    assert check.verdict == "proved" and float(design.sampling.T_max) >= 1


def test_hull_that_grows_is_refuted():
    family, law = Interval(gain=Gain(S=[[1]], L=[["0.5"]]), tighten="hull"), SamplingLaw.periodic(Exact("0.3"))
    _, check = made(family, scalar(law), 0)
    assert check.verdict == "refuted" and float(check.claim("contraction").witness.multiplier) > 1


def test_tightened_bounds_are_narrower():
    at = pendulum(SamplingLaw.periodic(Exact("0.1")))
    widths = [
        float(made(Interval(gain=PRINTED, tighten=tighten), at, 0)[1].bounds["final_width"].proved)
        for tighten in ("none", "intersect", "hull")
    ]
    assert abs(widths[0] - 17.2) < 1e-9 and widths[1] < 0.3 * widths[0] and widths[2] < 0.6 * widths[0]


def test_two_outputs():
    at = plant(
        [["-0.54", "-0.32", "0.41"], ["0.3", "0.2", "-0.7"], ["0.5", "-1", "0.1"]], [[1, 0, 0], [0, "0.5", 1]],
        up_to("0.05"),
        disturbance=box([-1] * 3, [1] * 3), noise=box(["-0.1"] * 2, ["0.1"] * 2),
    )  # fmt: skip
    for objective in ("given_period", "min_width", "max_period"):
        design, check = made(Interval(objective=objective), at, 0)
        assert design.outcome == "found" and check.verdict == "proved", objective


@pytest.mark.parametrize("scale", ["1e-6", "1e6"])
def test_extreme_time_scales_end_in_an_answer(scale):
    T = {"1e-6": "1e5", "1e6": "1e-7"}[scale]
    at = plant([[0, scale], [f"-{scale}", 0]], [[1, 0]], up_to(T))
    design, check = made(Interval(feedback="none"), at, 0)
    assert design.outcome == "found" and check.verdict == "proved"


def test_problems_that_validate_sees():
    at = replace(pendulum(up_to("0.1")), phi=(parse("0"), parse("sin(x1)", frozenset({"x1"}))))
    plan = SimulationPlan(Exact(1), initial_state=(Exact(0), Exact(0)))
    fields = {problem.path for problem in Interval(gain=Gain(S=[[1]], L=[[1]])).problems(at, plan)}
    assert fields == {"plant.phi[1]", "observer.gain.S", "observer.gain.L", "simulation.initial_box"}
    at = replace(pendulum(SamplingLaw("updated")), B=None)
    fields = {problem.path for problem in Interval(feedback="design").problems(at, None)}
    assert fields == {"measurement.sampling.updated", "observer.feedback"}
    wrong = Interval(feedback=Feedback(K_lower=[[1]], K_upper=[[1]])).problems(pendulum(up_to("0.1")), None)
    assert {problem.path for problem in wrong} == {"observer.feedback.K_lower", "observer.feedback.K_upper"}
    assert Interval(gain=PRINTED, feedback=PRINTED_K).problems(pendulum(up_to("0.1")), None) == []


def test_the_certificate_path_loads_no_solver():
    import subprocess
    import sys

    code = (
        "import sys; sys.path.insert(0, 'tests/families/interval')\n"
        "from cdobs_cli.families.interval import Interval\n"
        "assert 'numpy' not in sys.modules and 'flint' not in sys.modules, 'the card is light'\n"
        "from interval_plants import *\n"
        "from cdobs_cli.design import Design\n"
        "import cdobs_cli.families.interval.claims\n"
        "assert not {'clarabel', 'cvxpy', 'scipy', 'matplotlib'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_hard_numbers_end_in_an_answer():
    at = pendulum(up_to("0.1"))
    near = Gain(S=[[1, 1], [1, "1.00000000000000000001"]], L=[[3], [1]])  # singular in floats, not in rationals
    for family in (Interval(gain=near), Interval(gain=near, tighten="hull")):
        _, check = made(family, at, 0)
        assert check.verdict in ("undecided", "refuted")
    design, _ = made(Interval(gain=Gain(S=[["sqrt(2)", 2], [1, "sqrt(2)"]], L=[[3], [1]])), at, 0)
    assert design.outcome == "none" and "may be singular" in design.reason
    design, check = made(Interval(), plant([["1e100", 1], [0, "1e100"]], [[1, 0]], up_to("0.1")), 0)
    assert design.outcome == "none" and check.verdict == "undecided"
    _, check = made(Interval(gain=Gain(S=[["1e-90"]], L=[[3]])), plant([[1]], [[1]], up_to("0.1")), 0)
    assert check.verdict == "proved"
    design, check = made(Interval(feedback="design"), plant([[1]], [[1]], up_to("0.1"), B=[[0]]), 0)
    assert design.outcome == "none" and "held loop" in design.reason


def test_exhibits_of_a_design_and_its_run():
    at = pendulum(up_to("0.1"))
    family = Interval(objective="min_width")
    design, check = made(family, at)
    shown = family.exhibits(at, design, check, None)
    assert {chart.name for chart in shown.charts} == {"positivity", "trade_off"}
    assert {table.name for table in shown.tables} == {"widths", "sylvester"}
    widths = next(table for table in shown.tables if table.name == "widths")
    labels = ["bounds of the observer", "intersected with y at samples", "hull predictor"]
    assert [row[0] for row in widths.rows] == labels
    assert all(row[3] <= widths.rows[0][3] * (1 + 1e-9) for row in widths.rows)
    assert "printed condition" in shown.notes[0]


def test_error_system_contracts_where_the_bounds_are_proved():
    import numpy as np

    from cdobs_cli.certify.falsify import exponentials

    at = pendulum(SamplingLaw.periodic(Exact("0.2")))
    family = Interval(gain=PRINTED)
    maps = family.inclusion(at, {"S": PENDULUM_S, "L": PENDULUM_L}).floats
    rho = np.abs(np.linalg.eigvals(maps.jump @ exponentials(maps.base[None] * 0.2)[0])).max()
    assert 0 < rho < 1


def test_counterexample_of_the_feedback_runs_again():
    from cdobs_cli.simulate.witness import replay

    at, feedback = scalar(up_to("0.35")), Feedback(K_lower=[[-3]], K_upper=[[-3]])
    design, check = made(Interval(gain=Gain(S=[[1]], L=[["1.4"]]), feedback=feedback), at, 0)
    family = Interval()
    run = replay(family.inclusion(at, design.gain), check.claim("separation").witness)
    assert abs(run.multiplier - 1.0953377) < 1e-6 and float(run.stated) <= run.multiplier * (1 + 1e-9)
