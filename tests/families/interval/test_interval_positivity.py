"""The exact positivity limit: printed numbers, closed forms, and an independent computation on a grid."""

from fractions import Fraction
from math import exp, log

import numpy as np
import pytest
from interval_plants import PENDULUM, SCALAR, exact, floats
from scipy.linalg import expm
from scipy.optimize import brentq

from cdobs_cli.certify.falsify import exponentials
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.families.interval.positivity import positivity_limit
from cdobs_cli.families.interval.theorems import assumption_3, error_flow, theorem_1_positivity


def limit(z):
    return positivity_limit(error_flow(z.Q0), error_flow(z.Q1))


def bracket_holds(found, value, relative=1e-6):
    assert found.proved is not None and found.refuted is not None
    assert float(found.proved) <= value * (1 + 1e-12) and float(found.refuted) >= value * (1 - 1e-12)
    assert found.refuted - found.proved <= relative * value


@pytest.mark.parametrize(
    ("a0", "a1"),
    [("1", "1.4"), ("1", "4"), ("0", "1.5"), ("-1", "1.5"), ("-0.001", "3"), ("1e-6", "2e-6"), ("1e6", "1.5e6")],
)
def test_scalar_limit_is_the_closed_form(a0, a1):
    found = limit(exact([[a0]], [[1]], [[1]], [[a1]]))
    x, q = float(a0), float(a1)
    bracket_holds(found, 1 / q if x == 0 else log(q / (q - x)) / x)


def test_scalar_example_of_the_paper():
    z = exact(*SCALAR)
    bracket_holds(limit(z), 1.2527629684953683)
    _, printed = theorem_1_positivity(z.Q0, z.Q1)
    assert abs(float(printed) - 0.356431) < 5e-7


def test_weak_injection_is_positive_for_ever():
    found = limit(exact([[2]], [[1]], [[1]], [["1.5"]]))
    assert found.proved is None and found.refuted is None
    assert found.holds_until(fraction_ball(Fraction(10**9)))


def test_pendulum_of_the_paper():
    z = exact(*PENDULUM)
    found = limit(z)
    assert found.proved is not None and found.refuted is not None
    assert abs(float(found.proved) / 0.2879178 - 1) < 1e-6 and abs(float(found.refuted) / 0.2879178 - 1) < 1e-6
    assert found.holds_until(fraction_ball(Fraction("0.2879178")))
    assert found.fails_before(fraction_ball(Fraction("0.2879179")))
    _, printed = theorem_1_positivity(z.Q0, z.Q1)
    assert abs(float(printed) - 0.101285) < 5e-7
    assert assumption_3(z.Q1) == ()


def test_assumption_3_names_what_fails():
    z = exact([[0, 1], [-1, 0]], [[1, 0]], [[1, 0], [0, 1]], [[4], [4]])
    assert any("(2, 1)" in text for text in assumption_3(z.Q1))
    z = exact([[1]], [[1]], [[1]], [["-1.4"]])
    assert any("negative" in text for text in assumption_3(z.Q1))


def brute(z, horizon):
    """First s on a grid with a negative entry of E(s)."""
    M, N1 = error_flow(z.Q0), error_flow(z.Q1)
    size = len(M)
    grid = np.linspace(0, horizon, 1201)
    flows = np.array([np.block([[M, np.eye(size)], [np.zeros((size, 2 * size))]]) * s for s in grid])
    parts = exponentials(flows)
    E = parts[:, :size, :size] + parts[:, :size, size:] @ N1
    bad = np.nonzero(E.min(axis=(1, 2)) < -1e-12)[0]
    return (grid[bad[0] - 1], grid[bad[0]]) if len(bad) else None


@pytest.mark.parametrize("seed", range(12))
def test_limit_agrees_with_all_entries_on_a_grid(seed):
    """E has 4 n^2 entries; the proof looks at n of them."""
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(2, 4)), int(rng.integers(1, 3))
    text = lambda M: [[f"{v:.3f}" for v in row] for row in M]  # noqa: E731
    data = (
        text(rng.normal(size=(n, n))),
        text(rng.normal(size=(p, n))),
        text(rng.normal(size=(n, n)) + 2 * np.eye(n)),
        text(rng.normal(size=(n, p))),
    )
    found = limit(exact(*data))
    horizon = 2 * float(found.refuted) if found.refuted is not None else 5.0
    first = brute(floats(*data), horizon)
    if found.refuted is None:
        assert first is None or first[1] > float(found.proved or 1e9)
    else:
        assert first is not None
        assert first[0] <= float(found.refuted) and first[1] >= float(found.proved)


def test_refuted_end_has_a_vector_that_leaves():
    found = limit(floats_free := exact(*PENDULUM))
    M, N1 = error_flow(floats_free.Q0).floats, error_flow(floats_free.Q1).floats
    j, s = found.column, float(found.refuted) * (1 + 1e-4)
    e = np.zeros(4)
    e[j] = 1
    both = exponentials(np.block([[M, (N1 @ e).reshape(-1, 1)], [np.zeros((1, 5))]])[None] * s)[0]
    assert (both @ np.append(e, 1))[j] < 0


def test_time_scaling():
    """A and L ten times faster: the limit is ten times shorter."""
    slow = limit(exact([[0, 1], [-1, 0]], [[1, 0]], [[1, 0], [-1, 1]], [[4], [4]]))
    fast = limit(exact([[0, 10], [-10, 0]], [[1, 0]], [[1, 0], [-1, 1]], [[40], [40]]))
    assert abs(float(slow.proved) - 10 * float(fast.proved)) < 1e-6 * float(slow.proved)


def test_scaling_of_z_changes_nothing():
    one = limit(exact([[0, 1], [-1, 0]], [[1, 0]], [[1, 0], [-1, 1]], [[4], [4]]))
    two = limit(exact([[0, 1], [-1, 0]], [[1, 0]], [[3, 0], ["-0.5", "0.5"]], [[4], [4]]))
    assert abs(float(one.proved) - float(two.proved)) < 1e-6 * float(one.proved)


def test_monotone_in_the_injection():
    limits = [float(limit(exact([[1]], [[1]], [[1]], [[q]])).proved) for q in ("1.2", "1.4", "2", "4")]
    assert limits == sorted(limits, reverse=True)
    assert abs(limits[3] - log(4 / 3)) < 1e-7 and exp(1) > 2


def test_the_first_column_to_fail_decides():
    """Two outputs without coupling: limits 1 and 1/2; with a third that never fails."""
    found = limit(
        exact(
            [[0, 0, 0], [0, 0, 0], [0, 0, 2]],
            np.eye(3, dtype=int).tolist(),
            np.eye(3, dtype=int).tolist(),
            [[1, 0, 0], [0, 2, 0], [0, 0, 1]],
        )
    )
    bracket_holds(found, 0.5)
    assert found.column is not None and found.column % 3 == 1


def test_an_entry_that_grows_with_another_may_fail_first():
    """x2 grows at once and lifts x1 beyond 5/8: x1 is not taken to grow for ever while it still falls."""
    found = limit(exact([["0", "1.6"], ["1", "1"]], [[1, 0]], [[1, 0], [0, 1]], [["2"], ["0"]]))
    flow = np.array([[0, 1.6, -2], [1, 1, 0], [0, 0, 0]])
    bracket_holds(found, brentq(lambda s: expm(flow * s)[0] @ [1, 0, 1], 0.6, 0.65))
