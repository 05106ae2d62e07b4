"""Bounds of this family: periods that no gain survives, the best of everything proved, curves, unseen directions."""

from __future__ import annotations

from dataclasses import replace

import pytest
from designing import designed
from lpv_asking import asked, of_every_gain
from lpv_plants import family, linear_class, sine, up_to

from cdobs_cli.certify import design as designs
from cdobs_cli.certify.methods.any_gain import Face, NoGain
from cdobs_cli.certify.methods.spectral import SpectralRadius
from cdobs_cli.certify.methods.wirtinger.certificate import Wirtinger
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.families.lpv_zoh.curve import Point, running_maxima
from cdobs_cli.sampling import SamplingLaw


def refutes(plant, *faces):
    """Whether conditions (kind, order, slopes, period) show that no gain serves the plant."""
    listed = [Face(kind, order, tuple(map(Exact, slopes)), Exact(T)).document() for kind, order, slopes, T in faces]
    return NoGain(plant.sampling, listed).prove(of_every_gain(plant)).holds


def test_a_negative_multiplier_weighs_a_condition_the_wrong_way():
    """edot = v e - L e(t_k), v in [-1, 1]: p(1) > 0 is L > v, at each v. L = 2 meets both at a short period; their
    difference is a negative constant all the same."""
    plant = linear_class([["0"]], [["1"]], {(0, 0): ("-1", "1")}, SamplingLaw.periodic(Exact("0.1")))
    assert not refutes(plant, ("plus", 0, ["-1"], "0.1"), ("plus", 0, ["1"], "0.1"))
    assert not refutes(plant, ("plus", 0, ["1"], "0.1"), ("plus", 0, ["-1"], "0.1"))


def test_conditions_that_leave_a_gain_refute_nothing():
    """At T = ln 3 and v = 1, p(1) > 0 and p(-1) > 0 ask for 1 < L < 2."""
    plant = linear_class([["0"]], [["1"]], {(0, 0): ("-1", "1")}, SamplingLaw.periodic(Exact("log(3)")))
    assert not refutes(plant, ("plus", 0, ["1"], "log(3)"), ("minus", 0, ["1"], "log(3)"))


def test_curves_are_running_maxima_where_a_proof_serves_shorter_periods():
    def kept(law, points):
        return [(str(p.T), str(p.rate)) for p in running_maxima([Exact(T) for T in ("1", "2", "3", "4")], points, law)]

    def points(method):
        return [None if rate is None else Point(Exact(T), Exact(rate), method(Exact(T)), None)
                for T, rate in (("1", "0.5"), ("2", None), ("3", "0.7"), ("4", "0.2"))]  # fmt: skip

    up_to_four, constant = up_to("4"), SamplingLaw.periodic(Exact("4"))
    up_to_T = points(lambda T: SpectralRadius(up_to_four.with_period(T), "0"))
    assert kept(up_to_four, up_to_T) == [("1", "0.7"), ("2", "0.7"), ("3", "0.7"), ("4", "0.2")]
    # One constant period says nothing of another, unless the proof is for all periods up to it.
    assert kept(constant, points(lambda T: SpectralRadius(constant.with_period(T), "0"))) == [
        ("1", "0.5"),
        ("3", "0.7"),
        ("4", "0.2"),
    ]
    down = points(lambda T: Wirtinger(constant.with_period(T), [], [], "0"))
    assert kept(constant, down) == [("1", "0.7"), ("2", "0.7"), ("3", "0.7"), ("4", "0.2")]


def test_any_gain_is_the_best_of_everything_proved():
    """A gain found for a rate at a short period is not the one that lasts longest: the curve's last point is."""
    plant = sine(up_to("0.4"))
    card = family(method="wirtinger", objective="decay_rate")
    design = designed(card, plant, 1)
    check = card.certify(plant, design, 1)
    some, own = (float(check.bounds[name].proved) for name in ("period_max_any_gain", "period_max"))
    last = design.front[-1]
    assert some == float(last.period) > 1.1 * own
    assert Wirtinger.propose(asked(plant, last.gain["L"], last.period)) is not None
    rates = [float(point.rate) for point in design.front]
    assert rates == sorted(rates, reverse=True)
    claim = check.claim("period_max_any_gain.wirtinger")
    assert claim.status == "proved"
    assert float(check.envelope["rate"]) > 0
    # Another gain's certificate proves nothing of the design's own, and nothing where it is damaged.
    other = next(c for c in design.certificates if "L" in c.data)
    for data in ({**other.data, "L": [["5"], ["5"]]}, {**other.data, "L": "x"}, {**other.data, "L": [["1"]]}):
        damaged = replace(
            design, certificates=tuple(replace(c, data=data) if c is other else c for c in design.certificates)
        )
        assert card.certify(plant, damaged, 0).bounds["period_max_any_gain"].proved == check.bounds["period_max"].proved
    alone = replace(design, certificates=(other,))
    assert card.certify(plant, alone, 0).claim("convergence").status != "proved"


@pytest.mark.parametrize("objective", ["given_period", "max_period", "decay_rate"])
def test_what_is_never_seen_is_refuted_at_once(objective, monkeypatch):
    plant = linear_class(
        [["0", "1"], ["0", "0"]], [["0", "1"]], {(1, 0): ("-0.3", "0.3")}, SamplingLaw.periodic(Exact("0.6"))
    )
    for search in ("_candidates", "_certified"):  # nothing is looked for
        monkeypatch.setattr(designs._Synthesis, search, None)
    for card in (family(objective=objective), family(objective=objective, gain={"L": [["1"], ["1"]]})):
        design = designed(card, plant, 1)
        check = card.certify(plant, design, 1)
        convergence = check.claim("convergence")
        assert convergence.status == check.verdict == "refuted"
        assert convergence.witness.kind == "vector" and convergence.witness.about == "class"
        assert convergence.witness.data["direction"] == ["1", "0"]
        told = design.reason or check.claim("every_gain").statement
        assert "x1" in told and "measure" in told
        assert card.inclusion(plant, design.gain).gain["L"].shape == (2, 1)


def test_pathological_sampling_is_refuted_for_every_gain():
    plant = linear_class([["0", "1"], ["-1", "0"]], [["1", "0"]], {}, SamplingLaw.periodic(Exact("pi")))
    for card in (family(), family(gain={"L": [["0.5"], ["0.1"]]})):
        check = card.certify(plant, designed(card, plant, 0), 0)
        assert check.verdict == "refuted"
        witness = check.claim("convergence").witness
        assert (witness.kind, witness.about, witness.times, witness.data["direction"]) == (
            "vector",
            "plant",
            ("pi",),
            ["0", "1"],
        )
    nearby = replace(plant, sampling=SamplingLaw.periodic(Exact("3")))
    assert (
        family().certify(nearby, designed(family(gain={"L": [["0.2"], ["0.1"]]}), nearby, 0), 0).claim("every_gain")
        is None
    )


def test_two_held_outputs_of_a_linear_plant():
    plant = linear_class([["-2", "0"], ["0", "-0.9"]], [["1", "0"], ["0", "1"]], {}, up_to("1"))
    card = family(gain={"L": [["1", "0"], ["1", "1"]]})
    check = card.certify(plant, designed(card, plant, 0), 0)
    bound = check.bounds["period_max"]
    assert check.verdict == "proved"
    assert 3.25 < float(bound.proved) < float(bound.refuted) < 3.28
    assert check.bounds["period_max_any_gain"].proved == bound.proved
    rate = check.bounds["decay_rate"]
    assert 0.98 * float(rate.refuted) < float(rate.proved) < float(rate.refuted)


def test_a_held_dead_beat_has_no_finite_rate():
    plant = linear_class([["0"]], [["1"]], {}, SamplingLaw.periodic(Exact("0.5")))
    card = family(gain={"L": [["2"]]})
    check = card.certify(plant, designed(card, plant, 0), 0)
    assert check.verdict == "proved"
    assert check.bounds["decay_rate"].proved == check.claim("convergence").margin == "inf"
