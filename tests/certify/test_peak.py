"""Error bounds under bounded disturbance and noise, by chains of quadratic functions."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from noisy_examples import pendulum, sine

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.methods.base import Question, read
from cdobs_cli.certify.methods.peak.certificate import Peak


def bound(question: Question, i: int) -> float:
    proposal = Peak.propose(question.of_state(i))
    assert proposal is not None
    return float(proposal.prove(question).error.upper())


# The bounds of the theory note, and what an adversary reaches.
@pytest.mark.parametrize(
    ("T", "K", "least", "most"),
    [
        ("0.1", ("0.5805", "1.2368"), (0.0188, 0.0617), (0.01903, 0.0626)),
        ("0.3", ("0.8777", "1.6234"), (0.0288, 0.0741), (0.0293, 0.0752)),
        ("0.6", ("1", "1.47478"), (0.0535, 0.0981), (0.0560, 0.1019)),
        ("1.2", ("1", "0.88613"), (0.2, 0.26), (0.2357, 0.3009)),
    ],
)
def test_the_pendulum_of_the_note(T, K, least, most):
    for i in range(2):
        assert least[i] < bound(pendulum(T, K), i) < most[i]


def test_the_held_sine_plant_of_the_note():
    question = sine("1", ("1.5299", "1.0428"))
    assert 0.09 < bound(question, 0) < 0.1055 and 0.12 < bound(question, 1) < 0.1315


def test_a_stored_chain_speaks_for_its_own_plant_gain_and_law_only():
    question = pendulum("0.6", ("1", "1.47478"))
    proposal = Peak.propose(question.of_state(1))
    stored = json.loads(json.dumps(proposal.certificate().document()))

    def proved(about=question, change=None):
        chain = {**stored["data"]["chains"][0], **(change or {})}
        document = {**stored, "data": {**stored["data"], "chains": [chain]}}
        return read(Certificate.from_document(document), (Peak,)).method.prove(about)

    assert proved().error.upper() == proposal.prove(question).error.upper()
    assert not proved(pendulum("0.6", ("1", "1.6"))).holds
    assert not proved(pendulum("0.6", ("1", "1.47478"), c=("1.1", "0"))).holds
    chain = stored["data"]["chains"][0]
    P = chain["P"]
    shrunk = [[[str(float(x) * 0.99) for x in row] for row in P[0][0]], *P[0][1:]]
    for change in (
        {"P": [shrunk, *P[1:]]}, {"P": P[:-1]}, {"P": P[::-1]}, {"rho": "1"}, {"rho": "0.1"},
        {"window": ["0", "0.5"]}, {"window": ["0", "2"]}, {"nu": chain["nu"][::-1]}, {"mu": chain["mu"][:-1]},
        {"pieces": [["0", "0"], chain["pieces"][1]]}, {"degree": "0"},
    ):  # fmt: skip
        assert not proved(change=change).holds, change


def test_a_smaller_slope_class_has_no_larger_bound():
    whole, narrow = (bound(pendulum("0.6", ("1", "1.47478"), c=(c, "0")), 1) for c in ("1", "0.5"))
    assert 0.05 < narrow < whole


def test_what_is_remembered_of_a_slow_loop_serves_a_fast_one():
    """Loops that forget faster follow fewer intervals: cuts of the others are none of theirs."""
    memory = {}
    for K in (("0.5805", "1.2368"), ("0.2", "0.15"), ("1", "8"), ("0.5805", "1.2368")):
        question = replace(pendulum("0.1", K), memory=memory)
        assert bound(question, 1) > 0
