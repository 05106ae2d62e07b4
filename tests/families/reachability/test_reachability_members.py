"""F2: the few members of an interval matrix that decide a quadratic inequality over all of it."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.families.reachability.interval_matrix import IntervalMatrix


def random_box(rng, n, sparse=0.0):
    radius = np.abs(rng.normal(size=(n, n))) * (rng.uniform(size=(n, n)) >= sparse)
    return IntervalMatrix(Matrix.from_floats(rng.normal(size=(n, n))), Matrix.from_floats(radius))


def all_corners(box):
    center, radius = box.floats
    n = len(center)
    for signs in product((-1, 1), repeat=n * n):
        yield center + np.reshape(signs, (n, n)) * radius


@pytest.mark.parametrize(("n", "count"), [(2, 8), (3, 32), (4, 128)])
def test_counts(n, count):
    box = random_box(np.random.default_rng(1), n)
    assert len(list(box.signs(range(n)))) == count
    # Reduced to C e = 0 with one output: 2^(2n-2), so 64 for n = 4 where the paper has 65 536.
    assert len(list(box.signs(range(1, n)))) == 2 ** (2 * n - 2)


@pytest.mark.parametrize(("seed", "n", "sparse"), [(seed, 2 + seed % 2, 0.3 * (seed % 3)) for seed in range(12)])
def test_the_members_are_as_bad_as_all_corners(seed, n, sparse):
    # The least eigenvalue of P - M'SM over the whole box is attained at a member.
    rng = np.random.default_rng(seed)
    box = random_box(rng, n, sparse)
    S = rng.normal(size=(n, n))
    S = S @ S.T + 0.1 * np.eye(n)
    least = lambda matrices: min(np.linalg.eigvalsh(np.eye(n) - M.T @ S @ M)[0] for M in matrices)  # noqa: E731
    members = [box.member(signs).floats for signs in box.signs(range(n))]
    assert least(members) == pytest.approx(least(all_corners(box)), rel=1e-9)


def test_members_agree_in_floats_and_balls():
    box = random_box(np.random.default_rng(5), 3)
    signs = list(box.signs([1, 2]))
    exact = np.array([box.member(pair).floats for pair in signs])
    assert box.members(signs) == pytest.approx(exact, abs=1e-15)


def test_containment_needs_every_end():
    box = random_box(np.random.default_rng(2), 3)
    wider = IntervalMatrix(box.center, box.radius * 2)
    assert wider.contains(box)
    assert not box.contains(wider)
