"""Lemma III.1, corrected: the counterexample to the printed one, and random slope histories of any structure."""

from __future__ import annotations

import math

import numpy as np
import pytest
from flint import arb
from reachability_brute import bang_bang, histories
from reachability_plants import PRINTED, feedforward, plant, symmetric_chain

from cdobs_cli.exact.numbers import Exact
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.families.reachability.escape import escapes
from cdobs_cli.families.reachability.feedforward import columns_of, lemma_3_1
from cdobs_cli.families.reachability.sets import inclusion_12, matrix_set, reachable_box


def test_the_counterexample_is_covered_where_the_printed_set_is_not():
    box = lemma_3_1(feedforward(1), arb(1))
    M_13 = (float(box.lower.balls()[0, 2].mid()), float(box.upper.balls()[0, 2].mid()))
    printed = (-0.7 * math.e + 1.7, 0.3 - 1.3 / math.e)
    assert printed == pytest.approx((-0.2028, -0.1782), abs=5e-5)
    reached = bang_bang(feedforward(1), 1.0, (0, 0), 201)[:, 0, 2]
    assert (reached.min(), reached.max()) == pytest.approx((-0.2604, -0.1515), abs=5e-5)
    assert reached.min() < printed[0] < printed[1] < reached.max()
    assert M_13[0] <= reached.min() + 1e-12
    assert M_13[1] >= reached.max() - 1e-12
    # The bounding system is attained here: the box is not larger than it must be.
    assert list(M_13) == pytest.approx([reached.min(), reached.max()], abs=1e-4)


def random_plant(seed: int, n: int, triangular: bool):
    rng = np.random.default_rng(seed)
    mask = np.triu(np.ones((n, n))) if triangular else np.ones((n, n))
    A = np.round(rng.normal(size=(n, n)), 2) * mask
    low = -np.round(rng.uniform(0, 1, (n, n)) * (rng.uniform(size=(n, n)) < 0.5), 2) * mask
    up = np.round(rng.uniform(0, 1, (n, n)) * (rng.uniform(size=(n, n)) < 0.5), 2) * mask
    rows = lambda matrix: [[str(value) for value in row] for row in matrix.tolist()]  # noqa: E731
    return plant(rows(A), rows(low), rows(up), [[1] + [0] * (n - 1)], 1)


@pytest.mark.parametrize("seed", range(12))
def test_the_box_holds_every_history(seed):
    p = random_plant(seed, 2 + seed % 3, triangular=seed % 2 == 0)
    delta = 0.8
    box = lemma_3_1(p, arb(delta))
    Phi = histories(p, delta, 150, seed)
    assert np.all(Phi <= box.upper.floats + 1e-9)
    assert np.all(Phi >= box.lower.floats - 1e-9)


def test_an_even_structure_has_even_bounds():
    p = plant([[0] * 3] * 3, [[-1, -1, -1], [0, -1, -1], [0, 0, -1]], [[1, 1, 1], [0, 1, 1], [0, 0, 1]], [[1, 0, 0]], 1)
    box = lemma_3_1(p, arb(1))
    assert box.lower.floats[0, 1] == pytest.approx(-box.upper.floats[0, 1], abs=1e-15)
    assert box.upper.floats[0, 1] == pytest.approx(math.e, rel=1e-12)  # e_1 <= t exp(t) with both slopes at 1


def test_a_constant_plant_is_a_single_matrix():
    p = plant([[0, 1], [-4, 0]], [[0, 0]] * 2, [[0, 0]] * 2, [[1, 0]], 1)
    box = reachable_box(p, arb("0.5"))
    assert box.center.floats == pytest.approx(
        np.array([[math.cos(1), math.sin(1) / 2], [-2 * math.sin(1), math.cos(1)]]), abs=1e-14
    )
    assert len(list(box.signs([1]))) == 1


def test_stiff_plants_end_in_no_box_instead_of_a_long_wait():
    p = plant([["1e6", 1], [0, 0]], [[-1, 0], [0, 0]], [[1, 0], [0, 0]], [[1, 0]], 1)
    assert lemma_3_1(p, arb(1)) is None


PRINTED_FEEDFORWARD = {
    "matrices": [
        [
            [
                ["exp(delta)", "exp(-delta)"],
                ["exp(delta)-1", "1-exp(-delta)"],
                ["0.7+delta-0.7*exp(delta)", "1.3-delta-1.3*exp(-delta)"],
            ],
            [0, 1, "-delta"],
            [0, 0, 1],
        ]
    ]
}


def test_the_printed_set_is_refuted_by_a_history_that_leaves_it():
    family = Reachability(set=PRINTED_FEEDFORWARD)
    p = feedforward(1)
    boxes = matrix_set(family, p, Exact(1))
    assert not inclusion_12(reachable_box(p, arb(1)), boxes)
    witness = escapes(p, Exact(1), boxes)
    assert witness.data["entry"] == [1, 3]
    assert sum(float(Exact(t)) for t in witness.times) == pytest.approx(1)


def test_the_printed_pendulum_set_holds_every_error_and_nothing_refutes_it():
    family = Reachability(set=PRINTED)
    p = symmetric_chain((1, 0), "0.6")
    boxes = matrix_set(family, p, Exact("0.6"))
    assert inclusion_12(reachable_box(p, arb("0.6")), boxes)
    assert escapes(p, Exact("0.6"), boxes) is None


def test_listing_every_matrix_is_the_same_as_listing_values():
    from itertools import product

    values = [entry for row in PRINTED["matrices"][0] for entry in row]
    listed = [[[a, b], [c, d]] for a, b, c, d in product(*values)]
    assert len(listed) == 64  # as the paper counts
    p = symmetric_chain((1, 0), "0.6")
    one = matrix_set(Reachability(set=PRINTED), p, Exact("0.6"))
    two = matrix_set(Reachability(set={"matrices": listed}), p, Exact("0.6"))
    assert len(one) == len(two) == 1
    assert one[0].upper.floats == pytest.approx(two[0].upper.floats)
    assert one[0].lower.floats == pytest.approx(two[0].lower.floats)


def test_a_set_that_is_a_little_too_small_is_not_proved():
    p = symmetric_chain((1, 0), "0.6")
    first, last = ["cos(delta)", "cosh(delta)"], [["-sin(delta)", "sinh(delta)"], ["cos(delta)", "cosh(delta)"]]
    small = {"matrices": [[[first, ["sin(delta)", "0.9999999*sinh(delta)"]], last]]}
    exact = {"matrices": [[[first, ["sin(delta)", "sinh(delta)"]], last]]}
    box = reachable_box(p, arb("0.6"))
    assert inclusion_12(box, matrix_set(Reachability(set=exact), p, Exact("0.6")))
    boxes = matrix_set(Reachability(set=small), p, Exact("0.6"))
    assert not inclusion_12(box, boxes)
    assert escapes(p, Exact("0.6"), boxes).data["entry"] == [1, 2]


def test_a_dense_triangular_plant_of_six_states():
    n = 6
    chain_of_ones = [[int(j == i + 1) for j in range(n)] for i in range(n)]
    box_of = [[int(j >= i) for j in range(n)] for i in range(n)]
    p = plant(chain_of_ones, [[-v for v in row] for row in box_of], box_of, [[1] + [0] * (n - 1)], 1)
    box = lemma_3_1(p, arb("0.9"))
    Phi = histories(p, 0.9, 100)
    assert np.all(Phi <= box.upper.floats + 1e-9)
    assert np.all(Phi >= box.lower.floats - 1e-9)
    # A later period continues from the steps that were kept, and agrees with a fresh start.
    later = lemma_3_1(p, arb(1)).upper.floats
    columns_of.cache_clear()
    assert later == pytest.approx(lemma_3_1(p, arb(1)).upper.floats, rel=1e-12)
