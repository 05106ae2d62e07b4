import numpy as np
import pytest
from example_inclusions import canonical, impulsive, periodic, plant

from cdobs_cli.certify.floats import exponentials
from cdobs_cli.certify.methods.planar.every_gain import period_lost_by_every_gain, refute_every_gain
from cdobs_cli.certify.methods.planar.extremals import limit_any_gain, planar_class
from cdobs_cli.exact.numbers import Exact, decimal_text


def open_loop(c, T):
    return impulsive(canonical(c, periodic(T)), [["0"], ["0"]])


def test_pendulum_class_is_lost_by_every_gain_just_above_the_limit():
    """Proved for one gain at 1.7130, lost by all at 1.7131: the limit is 1.713057."""
    assert refute_every_gain(open_loop([1, 0], "1.7131"), 1) is not None
    assert refute_every_gain(open_loop([1, 0], "1.7130"), 0) is None
    assert refute_every_gain(open_loop([1, 0], "0.6"), 0) is None


@pytest.mark.parametrize("seed", range(5))
def test_random_pairs(seed):
    rng = np.random.default_rng(100 + seed)
    c = [decimal_text(float(x), 3) for x in 10 ** rng.uniform(-1.5, 1.0, 2)]
    family, _ = planar_class(open_loop(c, "1"))
    limit = limit_any_gain(family, 4.0 / max(float(c[1]), float(c[0]) ** 0.5))
    proved = Exact(decimal_text(limit * 0.9999, 8))
    T, refutation = period_lost_by_every_gain(lambda T: open_loop(c, str(T)), proved, 1)
    assert limit < float(T) < 1.001 * limit
    assert refutation.cells > 0
    assert refute_every_gain(open_loop(c, str(proved)), 0) is None


def test_where_the_argument_does_not_apply():
    zero = [[0, 0], [0, 0]]
    assert refute_every_gain(impulsive(plant(zero, zero, zero, [[0, 1]], periodic("1")), [["0"], ["0"]]), 0) is None
    linear = impulsive(plant([[0, 1], [0, 0]], zero, zero, [[1, 0]], periodic("9")), [["0"], ["0"]])
    assert refute_every_gain(linear, 0) is None  # K = (1, 1/9) stops it


def test_gains_drawn_at_random_do_fail():
    """Brute force beside the cells: each of many gains has a bang-bang word with rho >= 1 at 1.72."""
    delta, slots = 1.72, 12
    left, base = np.array([[0.0, 0], [1.0, 0]]), np.array([[0.0, 1.0], [0.0, 0.0]])
    steps = exponentials(np.array([base + left, base - left]) * delta / slots)
    maps = [
        np.linalg.matrix_power(steps[b], slots - k) @ np.linalg.matrix_power(steps[a], k)
        for a in (0, 1)
        for b in (0, 1)
        for k in range(slots)
    ]
    rng = np.random.default_rng(3)
    failed = 0
    for _ in range(60):
        K = np.array([rng.uniform(0.5, 1.5), rng.uniform(0.2, 1.2)])
        J = np.array([[1 - K[0], 0], [-K[1], 1]])
        single = [J @ Phi for Phi in maps]
        radii = [abs(np.linalg.eigvals(M)).max() for M in single] + [
            abs(np.linalg.eigvals(A @ B)).max() ** 0.5 for A in single for B in single[::3]
        ]
        failed += max(radii) > 0.995  # the slots are coarse
    assert failed == 60
