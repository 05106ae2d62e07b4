"""Laws that reach down to 0, dead beats under every law, and plants that no gain helps."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from reachability_asking import run
from reachability_plants import chain, plant, symmetric_chain

from cdobs_cli.certify import design as designs
from cdobs_cli.certify.methods.dead_beat import DeadBeat
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.sampling import SamplingLaw


def up_to(T):
    return SamplingLaw("aperiodic", Exact(0), Exact(T))


UNSTABLE = ([[0, 1], [5, 3]], [[0, 0], [-1, 0]], [[0, 0], [1, 0]], [[1, 0], [0, 1]])


@pytest.mark.parametrize(
    "law", [up_to(5), SamplingLaw.periodic(Exact(5)), SamplingLaw("aperiodic", Exact(1), Exact("1e9"))]
)
@pytest.mark.parametrize(
    "options", [{"gain": {"K": [[1, 0], [0, 1]]}}, {}, {"objective": "max_period"}, {"objective": "decay_rate"}]
)
def test_a_measured_state_is_reset_under_every_law(law, options):
    family = Reachability(**options)
    design, check = run(family, plant(*UNSTABLE, law))
    assert check.verdict == "proved"
    assert design.sampling == law
    assert check.bounds["period_max"].proved == check.bounds["period_max_any_gain"].proved == "inf"
    assert check.bounds["period_max"].refuted is None
    assert check.bounds["decay_rate"].proved == "inf"
    assert check.claim("convergence").margin == "inf"
    assert check.claim(DeadBeat.rung).status == "proved"
    # Of another gain the certificate says nothing.
    if "gain" in options:
        other = Reachability(gain={"K": [[1, 0], [0, "0.9"]]})
        changed = replace(design, gain={"K": other.gain.K})
        assert other.certify(plant(*UNSTABLE, law), changed, 0).claim("convergence").status != "proved"


def test_a_double_integrator_at_rest_after_two_samples():
    p = chain((0, 0), (0, 0), "0.5")
    _, check = run(Reachability(gain={"K": [[1], [2]]}), p)
    assert check.verdict == "proved"
    assert check.bounds["decay_rate"].proved == "inf"
    assert check.bounds["period_max"].proved != "inf"
    for bound in check.bounds.values():
        assert bound.proved not in ("-inf", "nan") and bound.refuted not in ("-inf", "nan")


def test_one_output_from_period_zero():
    p = plant([[1]], [[0]], [[0]], [[1]], up_to("0.2"))
    _, check = run(Reachability(gain={"K": [["0.5"]]}), p)
    assert check.verdict == "proved"
    bound = check.bounds["period_max"]
    assert 0.9995 * math.log(2) < float(bound.proved) < math.log(2) < float(bound.refuted) < 0.6932
    _, slow = run(Reachability(gain={"K": [["0.5"]]}), replace(p, sampling=up_to("0.694")))
    assert slow.verdict == "refuted"


@pytest.mark.parametrize(("C_K", "holds"), [("0.6", True), ("1", True), ("1.4", True), ("2", False), ("-0.1", False)])
def test_slopes_from_period_zero(C_K, holds):
    """A pendulum with C K in (0, 2): the jump keeps e_1 in part, and laws [0, T] are proved by the clock."""
    p = symmetric_chain((1, 0), up_to("0.4"))
    _, check = run(Reachability(gain={"K": [[C_K], ["0.7"]]}), p, 0)
    assert (check.verdict == "proved") is holds


def test_an_oscillator_at_half_turns_and_near_them():
    free = lambda T: plant([[0, 1], [-1, 0]], [[0, 0]] * 2, [[0, 0]] * 2, [[1, 0]], T)  # noqa: E731
    for family in (Reachability(), Reachability(gain={"K": [["1"], ["1"]]}), Reachability(objective="max_period")):
        design, check = run(family, free("pi"))
        witness = check.claim("convergence").witness
        assert check.verdict == "refuted"
        assert (witness.kind, witness.about, witness.data["direction"]) == ("vector", "plant", ["0", "1"])
        if design.outcome == "none":
            assert "x1" in design.reason
            assert float(check.bounds["period_max_any_gain"].refuted) == pytest.approx(math.pi, abs=1e-9)
        else:
            assert check.claim("every_gain").status == "proved"
    _, aperiodic = run(Reachability(), free(up_to(4)))
    assert aperiodic.verdict == "refuted"
    assert aperiodic.claim("convergence").witness.times == ("pi",)
    assert run(Reachability(), free("3.1"))[1].verdict == "proved"


def test_a_given_gain_for_a_plant_that_no_gain_helps_is_not_searched_for(monkeypatch):
    p = chain((-1, 0), (1, 0), "0.5", C=[[0, 1]], last=(0, 0))
    monkeypatch.setattr(designs._Synthesis, "_certified", None)
    _, check = run(Reachability(gain={"K": [[0], [1]]}), p)
    witness = check.claim("convergence").witness
    assert check.verdict == "refuted"
    assert (witness.kind, witness.about, witness.values) == ("vector", "class", (("0",),))
    assert "x0" in check.claim("every_gain").statement
