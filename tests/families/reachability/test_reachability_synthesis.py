"""The limits of the paper's example, larger chains, and plants that have no observer of this kind."""

from __future__ import annotations

import subprocess
import sys

import pytest
from reachability_asking import found_at, run
from reachability_plants import PRINTED, chain, feedforward, plant, symmetric_chain

from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.sampling import SamplingLaw

PENDULUM = symmetric_chain((1, 0), "0.6")


def bound(check, name):
    value = check.bounds[name].proved
    return None if value is None else float(value)


@pytest.mark.parametrize(
    ("family", "low", "limit", "K_2"),
    [
        # Dinh2014, Section IV: 0.668 and 1.8361 (with the sign of the observer's equation).
        (Reachability(objective="max_period", method="set", set=PRINTED), 0.66815, 0.668159, 1.8361),
        (Reachability(objective="max_period", method="set"), 1.2110, 1.211017, 0.8839931),
    ],
)
def test_the_pendulum_up_to_the_limit_of_the_set(family, low, limit, K_2):
    design, check = run(family, PENDULUM)
    assert check.verdict == "proved"
    assert low <= bound(check, "period_max.set") <= limit
    assert design.sampling.T_max == Exact(check.bounds["period_max.set"].proved)
    assert design.gain["K"].floats[1, 0] == pytest.approx(K_2, abs=2e-4)
    assert float(check.bounds["period_max"].refuted) > limit


@pytest.mark.parametrize(
    ("family", "below", "above"),
    [(Reachability(set=PRINTED), "0.66815", "0.66816"), (Reachability(), "1.2110", "1.21102")],
)
def test_just_below_the_limit_there_is_a_gain_and_just_above_there_is_none(family, below, above):
    assert found_at((family, PENDULUM), below).proof.holds
    assert found_at((family, PENDULUM), above) is None
    design, check = run(Reachability(method="set", set=family.set), symmetric_chain((1, 0), above))
    assert design.outcome == "short" and "a proof is" in design.reason
    assert check.verdict == "undecided"


def test_the_printed_gain_is_refuted_and_the_other_sign_is_proved():
    printed = Reachability(gain={"K": [["-1"], ["-1.8361"]]}, set=PRINTED)
    p = symmetric_chain((1, 0), "0.668")
    design, check = run(printed, p)
    assert design.outcome == "given"
    assert check.verdict == "refuted"
    witness = check.claim("convergence").witness
    assert witness.values == (("1",),)
    assert float(witness.multiplier) == pytest.approx(4.577, abs=5e-4)
    corrected = Reachability(gain={"K": [["1"], ["1.8361"]]}, set=PRINTED)
    _, check = run(corrected, p)
    assert check.claim("set.contraction").status == "proved"
    assert check.verdict == "proved"


def test_no_period_is_both_proved_and_refuted():
    for gain in ([["1"], ["1.8361"]], [["0.9"], ["1"]], [["1"], ["0.5"]]):
        _, check = run(Reachability(gain={"K": gain}), PENDULUM)
        period = check.bounds["period_max"]
        assert period.proved is None or period.refuted is None or float(period.proved) < float(period.refuted)


@pytest.mark.parametrize(
    ("c", "limit"),
    [((1, 0, 0), 1.19045), ((1, 1, 1), 0.36049), ((1, 0, 0, 0), 1.24640)],
)
def test_longer_chains(c, limit):
    _, check = run(Reachability(objective="max_period", method="set"), symmetric_chain(c, "0.3"))
    assert check.verdict == "proved"
    assert bound(check, "period_max.set") == pytest.approx(limit, abs=1e-5)


def test_five_states_at_a_given_period():
    design, check = run(Reachability(method="set"), symmetric_chain((1, 0, 0, 0, 0), "1"), 0)
    assert design.outcome == "found"
    assert check.verdict == "proved"


def test_best_takes_the_better_proof():
    _, by_set = run(Reachability(objective="max_period", method="set"), PENDULUM)
    _, best = run(Reachability(objective="max_period"), PENDULUM)
    assert bound(best, "period_max") >= 1.7130 > 1.6 > bound(by_set, "period_max")
    assert best.claim("convergence").by == "planar"
    # Above the root of sinh(delta - s) = sin(s), s = acot(tanh(delta / 2)), no gain with K1 = 1 survives.
    assert bound(best, "period_max") < 1.713057392453498
    assert bound(best, "period_max") < float(best.bounds["period_max"].refuted) < 1.7132
    assert float(best.bounds["period_max_any_gain"].proved) < 1.713057392453498


def test_the_clock_alone():
    _, check = run(Reachability(objective="max_period", method="clock"), PENDULUM)
    assert check.claim("convergence").by == "clock"
    assert 1.63 <= bound(check, "period_max") < 1.6672
    assert set(check.bounds) >= {"period_max", "period_max.clock"}
    assert "period_max.set" not in check.bounds


def test_decay_rate_is_no_worse_than_at_the_given_period():
    _, given = run(Reachability(), PENDULUM)
    _, fast = run(Reachability(objective="decay_rate"), PENDULUM)
    assert bound(fast, "decay_rate") >= bound(given, "decay_rate") > 0


def test_without_slopes_the_largest_period_is_not_bounded_by_the_set():
    _, check = run(Reachability(method="set"), chain((0, 0), (0, 0), 100))
    assert check.verdict == "proved"
    assert "delta_star" not in check.bounds


def test_feedforward():
    design, check = run(Reachability(method="set"), feedforward(1))
    assert design.outcome == "found"
    assert check.verdict == "proved"


@pytest.mark.parametrize(
    "p",
    [
        plant([[1, 0], [0, 2]], [[0, 0]] * 2, [[0, 0]] * 2, [[1, 0]], "0.5"),
        plant([[1, 0], [0, 1]], [[0, 0]] * 2, [[0, 0]] * 2, [[1, 1]], "0.5"),
        # A free oscillator sampled every half turn: exp(A delta) = -I, and y sees one direction only.
        plant([[0, 1], [-1, 0]], [[0, 0]] * 2, [[0, 0]] * 2, [[1, 0]], "pi"),
        chain((-1, 0), (1, 0), "0.5", C=[[0, 1]], last=(0, 0)),
    ],
)
def test_what_cannot_be_detected_has_no_design_and_a_reason(p):
    for method in ("best", "set", "clock"):
        design, check = run(Reachability(method=method), p)
        assert design.outcome == "none"
        assert "not detectable" in design.reason
        assert check.verdict == "refuted"
        convergence = check.claim("convergence")
        assert "not detectable" in convergence.statement
        assert convergence.witness.kind == "vector"
        assert Reachability().inclusion(p, design.gain).gain["K"].shape == (p.n, p.p)  # what the witness is run in


def test_an_oscillator_sampled_off_the_half_turn_has_one():
    _, check = run(Reachability(), plant([[0, 1], [-1, 0]], [[0, 0]] * 2, [[0, 0]] * 2, [[1, 0]], "3"))
    assert check.verdict == "proved"


def test_a_given_gain_for_an_undetectable_plant_is_refuted():
    p = plant([[1, 0], [0, 2]], [[0, 0]] * 2, [[0, 0]] * 2, [[1, 0]], "0.5")
    _, check = run(Reachability(gain={"K": [[1], [0]]}), p)
    assert check.verdict == "refuted"


def test_a_range_of_periods():
    law = SamplingLaw("aperiodic", Exact("0.2"), Exact("0.8"))
    design, check = run(Reachability(), symmetric_chain((1, 0), law))
    assert design.sampling == law
    assert check.verdict == "proved"
    assert check.claim("convergence").by == "clock"
    assert "period_max.set" not in check.bounds


def test_extreme_scales_end_in_a_finding():
    for c, T in ((("1e12", 0), "1e-6"), (("1e-12", 0), "1e6"), (("1e6", "1e6"), "1e6"), (("1e-6", "1e-6"), "1e-6")):
        design, check = run(Reachability(method="set"), symmetric_chain(c, T), 0)
        assert (design.outcome == "found") == (check.verdict == "proved")


@pytest.mark.parametrize(
    "p",
    [
        plant([["-pi"]], [[0]], [[0]], [[0]], "0.1"),  # nothing is measured, nothing needs to be
        plant([[0, "0.5"], [0, "0.5"]], [[0, 0]] * 2, [[0, 0]] * 2, [["-pi", 2]], "0.3"),
        plant([["sqrt(2)"]], [[0]], [["1e6"]], [[1]], "1e-6"),
        plant([[0, 1], [0, "1e30"]], [[0, 0], [-1, "-0.5"]], [[0, 0], [1, "1e6"]], [[1, 0], ["-0.3", "0.5"]], "0.1"),
    ],
)
def test_odd_plants_end_in_a_finding(p):
    for family in (Reachability(objective="max_period"), Reachability(gain={"K": [[0] * p.p for _ in range(p.n)]})):
        design, check = run(family, p, 0)
        family.exhibits(p, design, check, None)
        assert (design.outcome != "found") or check.verdict == "proved"


def test_two_outputs_and_an_irrational_one():
    p = chain((-1, 0, 0), (1, 0, 0), "0.5", C=[[1, 0, 0], [0, "sqrt(2)", 1]])
    design, check = run(Reachability(method="set"), p)
    assert design.outcome == "found"
    assert check.verdict == "proved"


def test_what_validate_sees():
    two = [[1], [1]]
    fields = lambda family, p: {problem.path for problem in family.problems(p, None)}  # noqa: E731
    assert fields(Reachability(), PENDULUM) == set()
    assert fields(Reachability(gain={"K": [[1, 2]]}), PENDULUM) == {"observer.gain.K"}
    assert fields(Reachability(method="clock", set=PRINTED), PENDULUM) == {"observer.set"}
    assert fields(Reachability(set={"matrices": [[[1]]]}), PENDULUM) == {"observer.set.matrices[0]"}
    assert fields(Reachability(), symmetric_chain((1, 0), SamplingLaw("updated"))) == {"measurement.sampling.updated"}
    law = SamplingLaw("aperiodic", Exact("0.1"), Exact("0.2"))
    assert fields(Reachability(method="set", gain={"K": two}), symmetric_chain((1, 0), law)) == {"measurement.sampling"}


def test_a_stored_design_is_checked_without_a_solver():
    code = """
import sys
from cdobs_cli.exact.numbers import ExactMatrix, Exact
from cdobs_cli.exact.expression import ZERO
from cdobs_cli.plant import Plant, Slopes
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.certificate import Certificate
from cdobs_cli.design import Design
from cdobs_cli.families.reachability import Reachability
law = SamplingLaw.periodic(Exact("0.6"))
p = Plant(("a", "b"), (), ExactMatrix([[0, 1], [0, 0]]), (ZERO, ZERO), None, ExactMatrix([[1, 0]]),
          Slopes(ExactMatrix([[0, 0], [-1, 0]]), ExactMatrix([[0, 0], [1, 0]])), law)
certificate = Certificate("set", law, {"form": "reduced", "Q": [["1"]], "rho_squared": "0.2"})
design = Design("reachability", "given", law, {"K": ExactMatrix([["1"], ["1.6"]])}, (certificate,))
check = Reachability().certify(p, design, 1)
assert check.verdict == "proved", check
loaded = {"clarabel", "cvxpy", "scipy", "matplotlib", "sympy"} & set(sys.modules)
assert not loaded, loaded
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_gain_is_the_printed_decimal():
    design, _ = run(Reachability(), PENDULUM, 0)
    assert design.gain["K"] == ExactMatrix(design.gain["K"].texts())
    assert all(len(text) <= 12 for row in design.gain["K"].texts() for text in row)
