"""Words of slopes, disturbance and noise that make an error large: proved in balls, read again, and run."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from example_inclusions import aperiodic, canonical, periodic, plant
from noisy_examples import asked, noisy, pendulum, sine
from scipy.linalg import expm

from cdobs_cli.certificate import Witness
from cdobs_cli.certify.adversary import attained, attains
from cdobs_cli.certify.falsify import refute
from cdobs_cli.certify.methods.peak.certificate import Peak
from cdobs_cli.certify.words import refutes
from cdobs_cli.errors import UsageError
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.plant import Box
from cdobs_cli.simulate.attained import replay_attained
from cdobs_cli.simulate.witness import replay

KNOWN = pendulum("0.6", ("1", "1.47478"))


# What dynamic programming and sweeps reach in the theory note.
@pytest.mark.parametrize(
    ("question", "i", "least"),
    [
        (KNOWN, 1, 0.0981), (pendulum("0.1", ("0.5805", "1.2368")), 1, 0.0619),
        (pendulum("0.3", ("0.8777", "1.6234")), 1, 0.0741), (pendulum("1.2", ("1", "0.88613")), 1, 0.2648),
        (sine("1", ("1.5299", "1.0428")), 0, 0.0968), (sine("1", ("1.5299", "1.0428")), 1, 0.1234),
        (pendulum(None, ("1", "1.47478"), law=aperiodic("0.2", "0.6")), 1, 0.1048),
    ],
)  # fmt: skip
def test_what_is_reached_is_proved_and_run(question, i, least):
    reached, witness = attained(question.inclusion, i, 1)
    assert least < float(reached) < 1.05 * least
    stored = Witness.from_document(json.loads(json.dumps(witness.document())))
    assert stored == witness and attains(question.inclusion, stored) == reached
    run = replay_attained(question.inclusion, stored)
    assert run.measured == pytest.approx(float(reached), rel=1e-5)
    assert len(run.t) == len(run.e) == len(run.V) == len(run.d) and len(run.t_k) == len(run.v)
    assert np.abs(run.e[:, i]).max() < 1.2 * float(reached)
    law = question.law
    assert np.all(np.diff(run.t_k) > float(law.T_min) - 1e-9) and np.all(np.diff(run.t_k) < float(law.T_max) + 1e-9)
    assert set(np.unique(run.d[:, 1])) <= {-0.05, 0.05} and set(np.unique(run.v)) <= {-0.01, 0.0, 0.01}
    document = run.document()
    assert document["error_measured"] == run.measured and float(document["error_proved"]) <= float(reached)


def test_a_linear_loop_reaches_the_sum_of_its_responses():
    """Without slopes, and without d: limsup |e_i| = v0 sum_k |(J Phi)^k K|_i just after a sample."""
    zero = [[0, 0], [0, 0]]
    made = noisy(plant([[0, 1], [-1, 0]], zero, zero, [[1, 0]], periodic("0.5")), None, ["0.1"])
    question = asked(Reachability(), made, [["0.9"], ["0.8"]])
    step, K = expm(np.array([[0, 1], [-1, 0]]) * 0.5), np.array([0.9, 0.8])
    M, total = (np.eye(2) - np.outer(K, [1, 0])) @ step, np.zeros(2)
    for k in range(400):
        total += np.abs(np.linalg.matrix_power(M, k) @ K) * 0.1
    reached, witness = attained(question.inclusion, 1, 1)
    assert witness.about == "plant" and witness.entries == ()
    # Between samples it may be larger still.
    assert total[1] * 0.998 < float(reached)
    bound = Peak.propose(question.of_state(1)).prove(question).error
    assert reached < bound < 1.1 * reached


@pytest.mark.parametrize(
    "change",
    [
        {"d": [["0", "0.06"]]}, {"d": [["0", "-0.06"]]}, {"d": [["0.01", "0.05"]]}, {"v": [["0.02"]]},
        {"values": ("2",)}, {"times": "0.7"}, {"state": 5}, {"at": 0},
        {"at": 10**6}, {"d": []}, {"v": [["x"]]}, {"arcs": [0]},
    ],
)  # fmt: skip
def test_a_word_that_leaves_what_is_declared_attains_nothing(change):
    _, witness = attained(KNOWN.inclusion, 1, 0)
    data, fields = dict(witness.data), {}
    for name, value in change.items():
        if name == "values":
            fields[name] = (value, *witness.values[1:])
        elif name == "times":
            fields[name] = (value, *witness.times[1:])
        elif name in ("d", "v") and value:
            data[name] = [*value, *data[name][1:]]
        else:
            data[name] = value
    assert attains(KNOWN.inclusion, replace(witness, data=data, **fields)) is None


def test_a_word_is_about_its_own_gain_law_and_boxes():
    reached, witness = attained(KNOWN.inclusion, 1, 1)
    assert not refutes(KNOWN.inclusion, witness)
    other = pendulum("0.6", ("1", "1.2"))
    assert attains(other.inclusion, witness) not in (None, reached)
    assert attains(pendulum("0.5", ("1", "1.47478")).inclusion, witness) is None
    quiet = asked(Reachability(), noisy(KNOWN.plant, [0, "0.05"], ["0.009"]), [["1"], ["1.47478"]])
    assert attains(quiet.inclusion, witness) is None
    silent = asked(Reachability(), noisy(KNOWN.plant, None, ["0.01"]), [["1"], ["1.47478"]])
    assert attains(silent.inclusion, witness) is None
    unstable = pendulum("0.6", ("1", "-3"))
    assert attains(unstable.inclusion, witness) is None and attained(unstable.inclusion, 1, 1) is None


def test_boxes_that_are_not_symmetric_are_kept():
    """v in [0, 0.01], d in [0.02, 0.05]: less is reached than |v| <= 0.01, |d| <= 0.05 allow."""
    plant_ = replace(
        KNOWN.plant, noise=Box((Exact(0),), (Exact("0.01"),)),
        disturbance=Box((Exact(0), Exact("0.02")), (Exact(0), Exact("0.05"))),
    )  # fmt: skip
    question = asked(Reachability(), plant_, [["1"], ["1.47478"]])
    reached, witness = attained(question.inclusion, 1, 1)
    whole, _ = attained(KNOWN.inclusion, 1, 1)
    assert 0.5 * whole < reached < whole
    assert {row[1] for row in witness.data["d"]} <= {"0.02", "0.05"} and {v for (v,) in witness.data["v"]} <= {
        "0",
        "0.01",
    }
    assert replay_attained(question.inclusion, witness).measured == pytest.approx(float(reached), rel=1e-5)


def test_more_effort_and_more_signals_reach_no_less():
    ends = [float(attained(KNOWN.inclusion, 1, effort)[0]) for effort in range(3)]
    assert min(ends) > 0.98 * max(ends)
    louder = asked(Reachability(), noisy(KNOWN.plant, ["0.01", "0.05"], ["0.01"]), [["1"], ["1.47478"]])
    assert float(attained(louder.inclusion, 1, 1)[0]) > ends[1]


def test_what_cannot_be_run_is_refused():
    made = noisy(canonical(["1", "0"], periodic("0.6")), [0, "0.05"], ["0.01"])
    diverging = asked(Reachability(), made, [["-1"], ["-1.8"]])
    with pytest.raises(UsageError, match="no noise"):
        replay_attained(diverging.inclusion, refute(diverging.inclusion, 1))
    _, witness = attained(KNOWN.inclusion, 1, 0)
    with pytest.raises(UsageError):
        replay(KNOWN.inclusion, witness)
    with pytest.raises(UsageError, match="cannot be read"):
        replay_attained(KNOWN.inclusion, replace(witness, data={}))
    other = asked(Reachability(), noisy(canonical([1, 1, 1], periodic("0.6")), [0, 0, 1], [1]), [["1"]] * 3)
    with pytest.raises(UsageError, match="another plant"):
        replay_attained(other.inclusion, witness)
