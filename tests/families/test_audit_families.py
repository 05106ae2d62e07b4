"""Stored designs that say more than they prove: certificates about other laws, designs for other periods."""

import json
from dataclasses import replace

import pytest
from command import Cdobs
from designing import designed

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.methods.any_gain import NoGain
from cdobs_cli.certify.methods.base import read
from cdobs_cli.certify.methods.rung import GENERAL
from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ZERO
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold
from cdobs_cli.families.lpv_zoh.printed_claims import _vertices_claim
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.families.updated_sampling.lipschitz import rate_claim, typed_rate
from cdobs_cli.families.updated_sampling.member import asked
from cdobs_cli.families.updated_sampling.synthesis import THEOREMS
from cdobs_cli.families.updated_sampling.synthesis import synthesize as updated
from cdobs_cli.plant import Plant, Slopes
from cdobs_cli.sampling import SamplingLaw

NONE = ExactMatrix([[0, 0], [0, 0]])
OSCILLATOR = ExactMatrix([[0, "pi"], ["-pi", 0]])


CONSTANT = Slopes(NONE, NONE)


def linear(A, law, slopes=CONSTANT):
    return Plant(("a", "b"), (), A, (ZERO, ZERO), None, ExactMatrix([[1, 0]]), slopes, law)


@pytest.mark.parametrize(
    ("name", "gain"), [("reachability", {"K": [["1"], ["0.3"]]}), ("lpv_zoh", {"L": [["0.4"], ["0.1"]]})]
)
def test_a_certificate_of_another_law_moves_no_bound(name, gain):
    """What holds for periods in [1, 1.2] says nothing of periods in [0.1, 1.2]."""
    card = {"reachability": Reachability, "lpv_zoh": LpvZeroOrderHold}[name].model_validate(
        {"family": name, "gain": gain}
    )
    at, wider = (
        linear(ExactMatrix([[0, 1], [-1, 0]]), SamplingLaw("aperiodic", Exact(low), Exact("1.2")))
        for low in ("1", "0.1")
    )
    names = {method.name for method in GENERAL.methods}
    stored = designed(card, at, 0).certificates
    clocks = tuple(c for c in stored if c.method in names and c.sampling.T_max == Exact("1.2"))
    assert (
        card.certify(at, Design(name, "given", at.sampling, dict(card.gain), clocks), 0).bounds["period_max"].proved
        == "1.2"
    )
    check = card.certify(wider, Design(name, "given", wider.sampling, dict(card.gain), clocks), 0)
    assert check.verdict == "undecided"
    bound = check.bounds.get("period_max")
    assert bound is None or bound.proved is None


def test_no_gain_under_one_law_says_nothing_of_another():
    """No gain serves every period up to 3 with slopes in [-0.3, 0.3]; that is no statement about the period 3."""
    slopes = Slopes(ExactMatrix([[0, 0], ["-0.3", 0]]), ExactMatrix([[0, 0], ["0.3", 0]]))
    any_law = linear(ExactMatrix([[0, 1], [0, 0]]), SamplingLaw("aperiodic", Exact(0), Exact(3)), slopes)
    card = LpvZeroOrderHold.model_validate({"family": "lpv_zoh", "gain": {"L": [["1.166"], ["0.332"]]}})
    hopeless = NoGain.propose(card.question(any_law, dict(card.given()), 0))
    assert hopeless is not None
    for at, refuted in ((any_law, "3"), (replace(any_law, sampling=SamplingLaw.periodic(Exact(3))), None)):
        check = card.certify(at, Design("lpv_zoh", "given", at.sampling, dict(card.gain), (hopeless.certificate(),)), 0)
        found = check.bounds.get("period_max_any_gain")
        assert (None if found is None else found.refuted) == refuted


@pytest.mark.parametrize("T", ["1", "2"])
def test_half_periods_of_an_oscillator_end_in_a_finding(T):
    at = linear(OSCILLATOR, SamplingLaw.periodic(Exact(T)))
    for card in (
        LpvZeroOrderHold.model_validate({"family": "lpv_zoh"}),
        Reachability.model_validate({"family": "reachability"}),
    ):
        design = designed(card, at, 0)
        assert design.outcome == "none" and design.reason
        assert card.certify(at, design, 0).verdict != "proved"


def test_vertices_that_balls_cannot_place_are_open():
    at = linear(NONE, SamplingLaw.periodic(Exact(1)), Slopes(NONE, ExactMatrix([[0, 0], ["pi", 0]])))
    inside, open_, outside = (
        ExactMatrix([[0, 0], [value, 0]]) for value in ("3", "(pi + 1e-60) - 2*pi + pi + pi", "3.2")
    )
    assert [_vertices_claim(at, (vertex,)).status for vertex in (inside, open_, outside)] == [
        "proved",
        "undecided",
        "refuted",
    ]


def test_updated_sampling_needs_the_signs_that_its_law_takes_for_granted():
    from cdobs_cli.families.updated_sampling import UpdatedSampling

    still = Plant(
        ("x1", "x2"), (), ExactMatrix([[0, 1], [0, 0]]), (ZERO, parse("sin(x1)", frozenset({"x1"}))), None,
        ExactMatrix([[1, 0]]), Slopes(ExactMatrix([[0, 0], [-1, 0]]), ExactMatrix([[0, 0], [1, 0]])),
        SamplingLaw("updated"),
    )  # fmt: skip
    card = UpdatedSampling.model_validate({"family": "updated_sampling"})
    design = updated(card, still, 0)
    stored = read(design.certificates[0], THEOREMS)
    question = asked(card, still, design.gain, 0)
    assert stored is not None and stored.method.prove(question).holds
    for name, wrong in (("a3", "-1"), ("alpha", f"-{design.gain['alpha'][0, 0]}"), ("a2", "0")):
        assert not stored.method.prove(question.with_gain({**design.gain, name: ExactMatrix([[wrong]])})).holds
    without = replace(still, phi=(ZERO, ZERO), slopes=Slopes(NONE, NONE))
    assert rate_claim(without, typed_rate(without, Exact("0").expression), "triangular").status == "proved"
    assert rate_claim(without, typed_rate(without, Exact("-1").expression), "triangular").status != "proved"


SPEC = """\
spec_version: 1
title: A design for a shorter period than asked
plant:
  states: [a, b]
  A: [[0, 1], [0, 0]]
  phi: ["0", "sin(a)"]
  lipschitz: [[0, 0], [1, 0]]
measurement:
  C: [[1, 0]]
  sampling: {period: 1.75}
observer:
  family: reachability
  gain: {K: [[1], [0.7]]}
"""


def test_a_stored_design_for_another_period_is_made_anew(cdobs: Cdobs, tmp_path):
    spec = tmp_path / "long.yaml"
    spec.write_text(SPEC)
    cdobs("check", str(spec), "-o", str(tmp_path / "out"), "--effort", "0")
    folder = tmp_path / "out" / "long"
    assert json.loads((folder / "check.json").read_text())["verdict"] != "proved"
    stored = json.loads((folder / "design.json").read_text())
    short = {"period": "0.5"}
    planar = Certificate("planar", SamplingLaw.periodic(Exact("0.5")), {"sigma": "0"}).document()
    (folder / "design.json").write_text(json.dumps({**stored, "sampling": short, "certificates": [planar]}))
    cdobs("check", str(spec), "-o", str(tmp_path / "out"), "--effort", "0")
    assert json.loads((folder / "check.json").read_text())["verdict"] != "proved"
    assert json.loads((folder / "design.json").read_text())["sampling"] == {"period": "1.75"}
