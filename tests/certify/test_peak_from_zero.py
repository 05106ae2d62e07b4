"""Error bounds where samples have no least distance."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from adversarial_runs import largest_errors
from example_inclusions import aperiodic, plant
from noisy_examples import asked, box, noisy, pendulum, sine

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.adversary import attained
from cdobs_cli.certify.methods.base import Question, read
from cdobs_cli.certify.methods.clock.certificate import split_basis
from cdobs_cli.certify.methods.named import ACCURACY
from cdobs_cli.certify.methods.peak.certificate import Peak
from cdobs_cli.certify.methods.peak.from_zero import PeakFromZero
from cdobs_cli.certify.methods.peak.split import split_error
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold
from cdobs_cli.families.reachability import Reachability


def efimov(L: Any) -> Question:
    """The pendulum of Efimov2016 with a held innovation, T_k in [0, 0.1]."""
    made = plant([[0, 1], [-1, 0]], [[0, 0], [0, 0]], [[0, 0], [0, 0]], [[1, 0]], aperiodic(0, "0.1"))
    return asked(LpvZeroOrderHold(), noisy(made, ["0.5", "0.5"], ["0.1"]), [[x] for x in L])


def proposed(question: Question, i: int) -> PeakFromZero:
    proposal = PeakFromZero.propose(question.of_state(i))
    assert proposal is not None
    return proposal


def bound(question: Question, i: int) -> float:
    return float(proposed(question, i).prove(question).error.upper())


@pytest.mark.parametrize(("L", "widths"), [(("4", "4"), (1.036, 2.518)), (("5.54", "6.21"), (0.889, 2.524))])
def test_the_pendulum_of_the_interval_family(L, widths):
    """Widths 2b of the theory note, or better; the interval observer has (3.8, 13.4)."""
    question = efimov(L)
    for i in range(2):
        reached, _ = attained(question.inclusion, i, 1)
        assert 2 * float(reached) < 2 * bound(question, i) < widths[i]


@pytest.mark.parametrize(
    ("question", "most"),
    [
        (pendulum(None, ("1", "1.2"), law=aperiodic(0, "0.6")), 1.95),
        (pendulum(None, ("1", "1.2"), law=aperiodic("0.05", "0.6")), 1.8),
        (pendulum(None, ("0.9", "1.2"), law=aperiodic(0, "0.3")), 1.9),  # C K = 0.9: a part of old noise is kept
        (sine(None, ("1.2", "0.6"), law=aperiodic(0, "0.8")), 1.8),
    ],
)
def test_bounds_hold_what_is_reached(question, most):
    runs = largest_errors(question, 60, 80, np.random.default_rng(1))
    for i in range(2):
        reached, _ = attained(question.inclusion, i, 1)
        assert runs[i] < bound(question, i) and float(reached) < bound(question, i) < most * float(reached)


def test_chains_prove_nothing_from_zero_and_samples_far_apart_are_left_to_them():
    question = pendulum(None, ("1", "1.2"), law=aperiodic(0, "0.6"))
    assert not Peak.applies(question)
    apart = pendulum(None, ("1", "1.2"), law=aperiodic("0.4", "0.6"))
    assert PeakFromZero.propose(apart.of_state(1)) is None and Peak.propose(apart.of_state(1)) is not None
    assert not PeakFromZero.applies(pendulum("0.6", ("1", "1.2")))


def test_a_stored_bound_speaks_for_its_own_plant_gain_and_law_only():
    question = pendulum(None, ("1", "1.2"), law=aperiodic(0, "0.6"))
    proposal = proposed(question, 1)
    stored = json.loads(json.dumps(proposal.certificate().document()))
    again = read(Certificate.from_document(stored), ACCURACY).method
    assert again == proposal and again.prove(question).error.upper() == proposal.prove(question).error.upper()
    assert not again.prove(pendulum(None, ("1", "1.4"), law=aperiodic(0, "0.6"))).holds
    assert not again.prove(pendulum(None, ("1", "1.2"), law=aperiodic(0, "0.6"), c=("1.2", "0"))).holds
    P = stored["data"]["P"]
    coupled = [[P[0][0][0], "0.001"], P[0][1]]
    for change in (
        {"P": [coupled, *P[1:]]}, {"P": P[::-1]}, {"P": P[:-1]}, {"sigma": "0"}, {"sigma": "-1"}, {"sigma": "3"},
        {"mu": stored["data"]["mu"][:-1]}, {"nu": []}, {"nu": ["0"]}, {"basis": [["1", "0"], ["0", "1"]]},
        {"basis": [["1", "1"], ["1", "1"]]}, {"pieces": ["1", "2"]}, {"degree": "0"}, {"state": "3"},
    ):  # fmt: skip
        document = {**stored, "data": stored["data"] | change}
        changed = read(Certificate.from_document(document), ACCURACY)
        assert changed is None or not changed.method.prove(question).holds, change
    for law in (aperiodic(0, "0.7"), aperiodic("0.1", "0.6")):
        assert not replace(again, law=law).prove(question).holds


@pytest.mark.parametrize("k", ["1", "0.5", "1.5", "2", "2.5"])
def test_noise_that_is_kept_adds_up_to_a_bound_or_to_none(k):
    """C K = k: what is left of all noise is at most |K| v0 / (1 - |1 - k|), for 0 < k < 2."""
    question = pendulum(None, (k, "1"), law=aperiodic(0, "0.3"))
    split = split_error(question, Matrix.from_rows(split_basis(question.inclusion)))
    kept = abs(1 - float(k))
    if kept >= 1:
        assert split is None
    else:
        left = np.abs((split.S @ split.H).floats) @ [float(size) for size in split.s0]
        assert left == pytest.approx(np.array([float(k), 1]) * 0.01 / (1 - kept))


def test_a_basis_that_does_not_part_what_is_kept_is_refused():
    question = pendulum(None, ("1", "1.2"), law=aperiodic(0, "0.3"))
    for rows in ([[1, 0], [0, 1]], [[0, 1], [1, 0]]):
        assert split_error(question, Matrix.from_rows(rows)) is None
    assert split_error(question, Matrix.identity(3)) is None


def test_the_transient_from_a_box():
    question = pendulum(None, ("1", "1.2"), law=aperiodic(0, "0.6"))
    start = box(["0.3", "0.2"])
    met = largest_errors(question, 200, 12, np.random.default_rng(8), start)
    for i in range(2):
        proposal = PeakFromZero.propose(question.of_state(i).started(start))
        assert proposal is not None and proposal.quantity(question.plant) == f"error_transient.x{i}"
        size = float(proposal.prove(question).error.upper())
        assert met[i] < size < 3 * met[i] and size > bound(question, i)
        wider = replace(proposal, start=[["-3", "3"], ["-2", "2"]])
        assert float(wider.prove(question).error.upper()) > size


def test_noise_of_one_output_of_two():
    """What the other sample leaves of e is 0: it is no state of the shift."""
    zero = [[0, 0], [0, 0]]
    made = plant([[0, 1], [0, 0]], zero, [[0, 0], ["0.2", 0]], [[1, 0], [0, 1]], aperiodic(0, "0.3"))
    question = asked(Reachability(), noisy(made, [0, "0.05"], ["0.01", 0]), [["0.8", 0], [0, "0.7"]])
    assert len(split_error(question, Matrix.from_rows(split_basis(question.inclusion))).s0) == 1
    for i in range(2):
        reached, _ = attained(question.inclusion, i, 1)
        assert float(reached) < bound(question, i) < 2.5 * float(reached)
