"""Error bounds under bounded disturbance and noise, by chains of quadratic functions."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from adversarial_runs import largest_errors
from example_inclusions import aperiodic, canonical, periodic, plant
from noisy_examples import asked, box, drawn, noisy, pendulum, sine
from test_output_slopes import seen_through

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.adversary import attained
from cdobs_cli.certify.methods.base import Question, read
from cdobs_cli.certify.methods.named import ACCURACY, loaded
from cdobs_cli.certify.methods.peak.certificate import Peak
from cdobs_cli.exact.numbers import Exact, upper_text
from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold
from cdobs_cli.families.reachability import Reachability

HALF = ("1", "1.47478")


def proposed(question: Question, i: int) -> Peak:
    proposal = Peak.propose(question.of_state(i))
    assert proposal is not None
    return proposal


def proved(method: Any, question: Question) -> float | None:
    error = method.prove(question).error
    return None if error is None else float(error.upper())


def bound(question: Question, i: int) -> float:
    size = proved(proposed(question, i), question)
    assert size is not None
    return size


# What an adversary reaches, and the bounds of the theory note or better.
@pytest.mark.parametrize(
    ("T", "K", "least", "most"),
    [
        ("0.1", ("0.5805", "1.2368"), (0.0189, 0.0620), (0.01902, 0.06225)),
        ("0.3", ("0.8777", "1.6234"), (0.0287, 0.0742), (0.0293, 0.0752)),
        ("0.6", HALF, (0.0533, 0.0981), (0.0551, 0.1010)),
        ("1.2", ("1", "0.88613"), (0.2039, 0.2649), (0.2287, 0.2934)),
    ],
)
def test_the_pendulum_of_the_note(T, K, least, most):
    for i in range(2):
        assert least[i] < bound(pendulum(T, K), i) < most[i]


def test_the_held_sine_plant_of_the_note():
    question = sine("1", ("1.5299", "1.0428"))
    assert 0.0968 < bound(question, 0) < 0.105 and 0.1234 < bound(question, 1) < 0.131
    windows = [chain.window for chain in proposed(question, 0).chains]
    assert windows == [["0", "0.25"], ["0.25", "0.5"], ["0.5", "0.75"], ["0.75", "1"]]


def changed(proposal: Peak, change: dict[str, Any]) -> Any:
    """The stored certificate with its chain changed, read again."""
    stored = json.loads(json.dumps(proposal.certificate().document()))
    stored["data"]["chains"][0] |= change
    return read(Certificate.from_document(stored), ACCURACY)


def test_a_stored_chain_speaks_for_its_own_plant_gain_and_law_only():
    question = pendulum("0.6", HALF)
    proposal = proposed(question, 1)
    stored = changed(proposal, {}).method
    assert stored == proposal and proved(stored, question) == proved(proposal, question)
    assert stored.quantity(question.plant) == "error.x1"
    assert proved(stored, pendulum("0.6", ("1", "1.6"))) is None
    assert proved(stored, pendulum("0.6", HALF, c=("1.1", "0"))) is None
    assert proved(stored, pendulum("0.6", HALF, c=("0.9", "0"))) is not None
    assert proved(replace(stored, law=aperiodic("0.3", "0.6")), question) is None
    assert proved(replace(stored, law=periodic("0.7")), question) is None
    assert proved(replace(stored, state="2"), question) is None
    chain = json.loads(json.dumps(proposal.certificate().document()))["data"]["chains"][0]
    P = chain["P"]
    shrunk = [[[str(Exact(x) * Exact("0.99")) for x in row] for row in P[0][0]], *P[0][1:]]
    for change in (
        {"P": [shrunk, *P[1:]]}, {"P": P[:-1]}, {"P": P[::-1]}, {"P": [P[0][:-1], *P[1:]]}, {"rho": "1"},
        {"rho": "0.1"}, {"window": ["0", "0.5"]}, {"window": ["0", "2"]}, {"window": ["0.5", "0.5"]},
        {"nu": chain["nu"][:-1]}, {"nu": [["0"], *chain["nu"][1:]]}, {"mu": chain["mu"][:-1]},
        {"mu": [[["0"], ["0"], ["0"], ["0"]], *chain["mu"][1:]]}, {"pieces": [["0", "0"], chain["pieces"][1]]},
        {"pieces": [chain["pieces"][0], ["0", "4"]]}, {"degree": "0"}, {"degree": "6"}, {"elevated": "3"},
    ):  # fmt: skip
        again = changed(proposal, change)
        assert again is None or proved(again.method, question) is None, change


def test_what_is_remembered_of_a_slow_loop_serves_a_fast_one():
    """Loops that forget faster follow fewer intervals: cuts of the others are none of theirs."""
    memory = {}
    for K in (("0.5805", "1.2368"), ("0.2", "0.15"), ("1", "8"), ("0.5805", "1.2368")):
        question = replace(pendulum("0.1", K), memory=memory)
        assert bound(question, 1) > 0


def test_a_flipped_digit_is_no_proof_or_still_a_true_bound():
    question = pendulum("0.6", HALF)
    proposal, (reached, _) = proposed(question, 1), attained(question.inclusion, 1, 1)
    text = json.dumps(proposal.certificate().document())
    rng, lost = np.random.default_rng(2), 0
    places = [at for at, letter in enumerate(text) if letter.isdigit() and text[at - 1] in '"-']
    for at in rng.choice(places, 60, replace=False):
        flipped = text[:at] + str((int(text[at]) + 1 + rng.integers(8)) % 10) + text[at + 1 :]
        stored = read(Certificate.from_document(json.loads(flipped)), ACCURACY)
        error = None if stored is None else stored.method.prove(question).error
        lost += error is None
        assert error is None or stored.method.state != "1" or error > reached
    assert lost > 40


def test_bounds_scale_with_the_signals_and_grow_with_each():
    question = pendulum("0.6", HALF)
    proposal, whole = proposed(question, 1), bound(question, 1)
    for share in ("1/3", "2"):
        d0, v0 = (str(Exact(size) * Exact(share)) for size in ("0.05", "0.01"))
        scaled = asked(Reachability(), noisy(question.plant, [0, d0], [v0]), [[x] for x in HALF])
        assert proved(proposal, scaled) == pytest.approx(whole * float(Exact(share)), rel=1e-12)
    quiet = asked(Reachability(), noisy(question.plant, [0, "0.05"], ["0.005"]), [[x] for x in HALF])
    calm = asked(Reachability(), noisy(question.plant, [0, "0.01"], ["0.01"]), [[x] for x in HALF])
    narrow = pendulum("0.6", HALF, c=("0.5", "0"))
    for less in (quiet, calm, narrow):
        assert bound(less, 1) < whole
    # A disturbance that starts to act is another column: the certificate does not speak of it.
    other = asked(Reachability(), noisy(question.plant, ["0.001", "0.05"], ["0.01"]), [[x] for x in HALF])
    assert proved(proposal, other) is None


def test_states_in_other_units_have_the_same_bounds():
    """e_2 in units of 1/1000, time in minutes: A, slopes, gain, law and disturbance follow."""
    whole = bound(pendulum("0.6", HALF), 1)
    k, m = Fraction(1000), Fraction(60)
    made = plant(
        [[0, str(m / k)], [0, 0]], [[0, 0], [str(-m * k), 0]], [[0, 0], [str(m * k), 0]], [[1, 0]], periodic("0.01")
    )
    gain = [["1"], [str(k * Fraction("1.47478"))]]
    other = asked(Reachability(), noisy(made, [0, str(k * m * Fraction("0.05"))], ["0.01"]), gain)
    assert bound(other, 1) == pytest.approx(1000 * whole, rel=1e-4)


@pytest.mark.parametrize("sizes", [([0, "0.05"], None), (None, ["0.01"]), ([0, 0], ["0.01"]), ([0, 0], [0])])
def test_one_of_disturbance_and_noise_is_enough_and_none_leaves_no_error(sizes):
    question = asked(Reachability(), noisy(pendulum("0.6", HALF).plant, *sizes), [[x] for x in HALF])
    met, size = attained(question.inclusion, 1, 1), bound(question, 1)
    if sizes[1] == [0]:
        assert size == 0 and met is None
    else:
        assert float(met[0]) <= size < 1.1 * float(met[0])


def test_nothing_is_proved_of_white_signals_or_of_none():
    question = pendulum("0.6", HALF)
    white = replace(question.plant, noise=None, covariance=question.gain("K"))
    for other in (white, noisy(question.plant, None, None)):
        about = asked(Reachability(), other, [[x] for x in HALF])
        assert not Peak.applies(about) and proved(proposed(question, 1), about) is None


def test_irrational_data_are_proved_in_balls():
    made = noisy(canonical(["1", "0"], periodic("pi/5")), [0, "0.05"], ["1/100"])
    question = asked(Reachability(), made, [["1"], ["sqrt(2)"]])
    reached, _ = attained(question.inclusion, 1, 1)
    assert float(reached) < bound(question, 1) < 1.05 * float(reached)


@pytest.mark.parametrize("held", [False, True])
def test_outputs_whose_slopes_vary(held):
    law = periodic("0.4")
    chain = canonical(["0.3", "0"], law)
    made = seen_through(chain, [["0.9", 0]], [["1.1", 0]])
    card, gain = (LpvZeroOrderHold(), [["1.5"], ["1.1"]]) if held else (Reachability(), [["0.9"], ["1.2"]])
    question = asked(card, noisy(made, [0, "0.05"], ["0.01"]), gain)
    reached, witness = attained(question.inclusion, 1, 1)
    assert "outputs" in witness.data
    size = bound(question, 1)
    assert float(reached) < size < 1.25 * float(reached)
    straight = asked(card, noisy(chain, [0, "0.05"], ["0.01"]), gain)
    assert bound(straight, 1) < size
    assert proved(proposed(straight, 1), question) is None
    assert largest_errors(question, 50, 40, np.random.default_rng(3))[1] < size


def test_an_interval_of_periods_and_the_transient_from_a_box():
    question = pendulum(None, HALF, law=aperiodic("0.2", "0.6"))
    rng, start = np.random.default_rng(4), box(["0.3", "0.2"])
    sizes = [bound(question, i) for i in range(2)]
    assert np.all(largest_errors(question, 100, 40, rng) < sizes)
    proposals = [Peak.propose(question.of_state(i).started(start)) for i in range(2)]
    from_start = [proved(proposal, question) for proposal in proposals]
    met = largest_errors(question, 200, 12, rng, start)
    assert np.all(met < from_start) and np.all(np.array(from_start) < 1.35 * met)
    assert [one.quantity(question.plant) for one in proposals] == ["error_transient.x0", "error_transient.x1"]
    assert proposals[0].holds_from(box(["0.3", "0.1"])) and not proposals[0].holds_from(box(["0.31", "0.1"]))
    again = read(Certificate.from_document(json.loads(json.dumps(proposals[0].certificate().document()))), ACCURACY)
    assert again.method == proposals[0]
    wider = replace(proposals[1], start=[["-0.3", "0.3"], ["-0.4", "0.4"]])
    assert proved(wider, question) > from_start[1]
    for start_texts in ([["-0.3", "0.3"]], [["0.3", "-0.3"], ["0", "0"]], [["a", "b"], ["0", "0"]]):
        assert proved(replace(proposals[1], start=start_texts), question) is None


def test_a_transient_from_no_error_is_the_bound_in_the_long_run():
    question = pendulum("0.6", HALF)
    proposal = Peak.propose(question.of_state(1).started(box([0, 0])))
    assert proved(proposal, question) == pytest.approx(bound(question, 1), rel=1e-4)


def test_the_error_before_the_first_sample_counts():
    """theta is read at t = 0 and set right: only before is |e_1| = 2."""
    question = pendulum("0.6", HALF)
    proposal = Peak.propose(question.of_state(0).started(box(["2", 0])))
    assert upper_text(proposal.prove(question).error, 12) == "2"


@pytest.mark.parametrize("seed", range(6))
def test_no_run_passes_a_bound(seed):
    rng = np.random.default_rng(100 + seed)
    question = drawn(rng)
    start = box([f"{size:.2f}" for size in rng.uniform(0, 1, question.plant.n)])
    runs = largest_errors(question, 60, 50, rng)
    from_start = largest_errors(question, 60, 50, rng, start)
    met = 0
    for method in loaded(ACCURACY):
        for i in range(question.plant.n if method.applies(question) else 0):
            for about, largest in ((question.of_state(i), runs), (question.of_state(i).started(start), from_start)):
                proposal = method.propose(about)
                if proposal is not None:
                    met += 1
                    size = proved(proposal, question)
                    assert largest[i] <= size * (1 + 1e-9)
                    reached = attained(question.inclusion, i, 0)
                    assert about.start is not None or reached is None or float(reached[0]) <= size
    assert met
