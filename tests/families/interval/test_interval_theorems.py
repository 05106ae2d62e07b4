"""Boundedness, LMI (15), Theorem 2, and the held loop against the paper's and independent numbers."""

from dataclasses import replace
from fractions import Fraction
from math import log, pi, sqrt

import numpy as np
import pytest
from interval_plants import PENDULUM, PENDULUM_S, SCALAR, asked, exact, floats, pendulum, question, scalar, up_to

from cdobs_cli.certify.methods.base import read
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.interval.feedback_design import descriptor_design
from cdobs_cli.families.interval.held import growth, growth_and_slope, interval
from cdobs_cli.families.interval.held_loop import HeldLoop, decrease, decrease_over, refute_held_loop
from cdobs_cli.families.interval.hurwitz import final_width, find_w_star, prove_hurwitz, refute_hurwitz
from cdobs_cli.families.interval.lmi_15 import Lmi15, lmi_15_limit
from cdobs_cli.families.interval.system import System
from cdobs_cli.families.interval.theorem_2 import Theorem2, gain_limit, refute_theorem_2, spectral_norm
from cdobs_cli.families.interval.theorems import lmi_15, observer_loop, width_matrix
from cdobs_cli.sampling import SamplingLaw


def width_of(z):
    return width_matrix(z.Q0, z.Q1)


def test_pendulum_settles_at_the_width_of_the_paper():
    z = exact(*PENDULUM)
    w_star = find_w_star(width_of(floats(*PENDULUM)))
    assert w_star is not None and prove_hurwitz(width_of(z), w_star.balls()) > 0
    width = final_width(z, width_of(z), Matrix.from_rows([[1], [1]]), Matrix.from_rows([[Fraction(1, 5)]]))
    assert [round(float(row[0]), 10) for row in width.floats] == [3.8, 13.4]


@pytest.mark.parametrize("seed", range(8))
def test_hurwitz_is_decided_as_by_eigenvalues(seed):
    rng = np.random.default_rng(seed)
    M = np.abs(rng.normal(size=(3, 3))) - np.diag(rng.uniform(0, 5, 3))
    exact_M = Matrix.from_floats(M)
    w = find_w_star(M)
    stable = np.linalg.eigvals(M).real.max() < 0
    assert (w is not None and prove_hurwitz(exact_M, w.balls()) is not None) == stable
    witness = refute_hurwitz(exact_M)
    assert (witness is not None) == (not stable)
    if witness is not None:
        v = np.array([float(t) for t in witness.data["width"]])
        assert np.all(v >= 0) and np.all((M @ v)[v > 0] > 0)


def test_a_weak_injection_is_not_bounded():
    """q1 <= a0 keeps the bounds in order for ever and lets the width grow: the paper's lower bound is no stability."""
    z = exact([[2]], [[1]], [[1]], [["1.5"]])
    assert refute_hurwitz(width_of(z)) is not None


@pytest.mark.parametrize(("data", "limit"), [(PENDULUM, pi / 8), (SCALAR, pi / 2.8)])
def test_frontier_of_lmi_15(data, limit):
    within, beyond = (asked(*data, T=f"{limit * share:.15f}") for share in (0.9995, 1.0005))
    found = Lmi15.propose(within)
    assert found is not None and found.prove(within).holds
    assert replace(found, law=up_to(f"{limit / 3:.9f}")).prove(within).holds  # affine in tau: holds below as well
    assert read(found.certificate(), (Lmi15,)).method == found
    assert Lmi15.propose(beyond) is None
    assert not replace(found, law=beyond.law).prove(beyond).holds
    assert abs(float(lmi_15_limit(exact(*data))) - limit) < 1e-12


def test_a_shrunk_certificate_of_lmi_15_is_not_proved():
    at = asked(*PENDULUM, T="0.1")
    found = Lmi15.propose(at)
    assert found is not None and found.prove(at).holds
    zero = ExactMatrix([[0, 0], [0, 0]])
    assert not replace(found, P=(zero, found.P[1])).prove(at).holds
    assert not replace(found, W=(found.W[0], zero)).prove(at).holds


def test_lmi_15_as_one_matrix_of_the_paper():
    """An independent transcription: the paper's full Phi_0, Phi_1 and block diagonal P, W in sum and difference."""
    f, found = floats(*PENDULUM), Lmi15.propose(asked(*PENDULUM, T="0.1"))
    assert found is not None
    s, d = 0.5 * np.ones((2, 2)), 0.5 * np.array([[1, -1], [-1, 1]])
    P, W = (np.kron(s, pair[0].floats) + np.kron(d, pair[1].floats) for pair in (found.P, found.W))
    up, down = np.maximum(f.Q0, 0), np.maximum(-f.Q0, 0)
    # the last row keeps its diagonal (Q0,4 is split off the diagonal only)
    up[1, 1], down[1, 1] = f.Q0[1, 1], 0
    Phi_0, Phi_1 = np.block([[up, -down], [-down, up]]), np.kron(np.eye(2), f.Q1)
    F, tau = Phi_0 + Phi_1, 2 * 0.1 / pi
    first, second = [P @ F + F.T @ P, tau * P @ Phi_1, F.T @ W], [tau * Phi_1.T @ P, -W, tau * Phi_1.T @ W]
    full = np.block([first, second, [W @ F, tau * W @ Phi_1, -W]])
    assert np.linalg.eigvalsh(full).max() < 0 and np.linalg.eigvalsh(P).min() > 0
    assert np.allclose(lmi_15(Phi_0, Phi_1, P, W, tau), full)


def scalar_loop(T):
    return asked(*SCALAR, T=T, K_lower=[[-3]], K_upper=[[-3]])


def pendulum_loop(T):
    return asked(*PENDULUM, T=T, K_lower=[["-1/8", "-1/8"]], K_upper=[["-1/16", "-1/16"]])


@pytest.mark.parametrize(("T", "small"), [("0.1", True), ("0.193", True), ("0.1938", False), ("0.25", False)])
def test_theorem_2_holds_for_the_scalar_only_below_0_1934(T, small):
    at = scalar_loop(T)
    limit = gain_limit(System.of(at))
    assert abs(float(limit) - sqrt(0.5)) < 1e-6
    found = Theorem2.propose(at)
    assert found is not None and found.prove(at).holds
    assert (Exact(found.gamma).ball() < limit) == small
    assert not replace(found, gamma=str(float(found.gamma) * 0.98)).prove(at).holds
    assert read(found.certificate(), (Theorem2,)).method == found


def test_theorem_2_has_no_solution_for_the_scalar_at_0_35():
    assert Theorem2.propose(scalar_loop("0.35")) is None


def test_theorem_2_of_the_pendulum_is_refuted_by_the_static_gain():
    at = pendulum_loop("0.1")
    limit = gain_limit(System.of(at))
    assert abs(float(limit) - 0.541196) < 1e-6
    witness = refute_theorem_2(System.of(at).loop, limit)
    assert witness is not None and abs(float(witness.data["static_gain"]) - 2.737) < 5e-4
    found = Theorem2.propose(at)
    assert found is not None and 2.737 < float(found.gamma) < 3


def test_theorem_2_gain_bounds_the_simulated_response():
    """Independent: the L2 gain over periodic inputs y cannot exceed the proved gamma."""
    at = pendulum_loop("0.1")
    found, float_loop = Theorem2.propose(at), System.of(at).float_loop
    assert found is not None
    from cdobs_cli.certify.falsify import exponentials

    size = 4
    E = exponentials(np.block([[float_loop.Phi_0, np.eye(size)], [np.zeros((size, 2 * size))]])[None] * 0.1)[0]
    F = E[:size, :size] + E[:size, size:] @ float_loop.Phi_2
    G = E[:size, size:] @ float_loop.Lambda
    gains = [np.linalg.norm(np.linalg.solve(np.exp(1j * w) * np.eye(size) - F, G), 2) for w in np.linspace(0, pi, 400)]
    assert max(gains) <= float(found.gamma) * (1 + 1e-9)


def test_spectral_norm_is_enclosed():
    rng = np.random.default_rng(1)
    for _ in range(5):
        M = rng.normal(size=(3, 2))
        ball = spectral_norm(Matrix.from_floats(M))
        value = np.linalg.norm(M, 2)
        assert float(ball.lower()) <= value * (1 + 1e-12) and float(ball.upper()) >= value * (1 - 1e-12)
        assert float(ball.upper()) - float(ball.lower()) < 1e-8


def held(plant, K_lower, K_upper, S):
    at = question(plant, {"S": S, "K_lower": ExactMatrix(K_lower), "K_upper": ExactMatrix(K_upper)})
    return HeldLoop.propose(at) is not None, refute_held_loop(at)


@pytest.mark.parametrize(("T", "stable"), [("0.3", True), ("0.3364", True), ("0.3366", False), ("0.35", False)])
def test_printed_feedback_of_the_scalar_loses_stability_at_log_1_4(T, stable):
    proved, witness = held(scalar(up_to(T)), [[-3]], [[-3]], ExactMatrix([[1]]))
    assert proved == stable and (witness is not None) == (not stable)
    assert (float(T) < log(1.4)) == stable
    if witness is not None and T == "0.35":
        assert witness.about == "class"  # of no uncertain slopes: the plant alone
        assert abs(float(witness.multiplier) - 1.0953) < 5e-5
        assert abs(float(witness.data["eigenvalue"][0]) + 1.0953) < 5e-5


def test_printed_feedback_of_the_pendulum_is_separated():
    proved, witness = held(pendulum(up_to("0.1")), [["-1/8", "-1/8"]], [["-1/16", "-1/16"]], PENDULUM_S)
    assert proved and witness is None


def test_values_and_slopes_over_an_interval_hold_every_point_of_it():
    """Phi' against differences of Phi, and the decrease at points against its enclosure over the interval."""
    rng = np.random.default_rng(5)
    for n in (1, 2, 3):
        A, closed, root = (Matrix.from_floats(rng.normal(size=(n, n)).round(2)) for _ in range(3))
        P = root.T @ root
        ball, h = interval(Fraction(1, 5), Fraction(1, 2)), Fraction(1, 10**8)
        V, over = decrease_over(P, A, closed, ball)
        for share in (0, Fraction(1, 3), 1):
            s = Fraction(1, 5) + share * Fraction(3, 10)
            Phi, slope = growth_and_slope(A, closed, fraction_ball(s))
            below, above = (growth(A, closed, fraction_ball(s + step)).floats for step in (-h, h))
            assert np.allclose(slope.floats, (above - below) / float(2 * h), rtol=1e-6, atol=1e-6)
            assert np.allclose(Phi.floats, growth(A, closed, fraction_ball(s)).floats)
            inside = V.T @ decrease(P, Phi, fraction_ball(s)) @ V
            assert all(over[i, j].contains(inside[i, j]) for i in range(n) for j in range(n))


def test_held_loop_is_decided_as_by_the_spectral_radius():
    from cdobs_cli.certify.falsify import exponentials

    rng = np.random.default_rng(3)
    seen = set()
    for _ in range(10):
        K = [[f"{v:.2f}" for v in rng.normal(size=2) * 2]]
        T = f"{rng.uniform(0.2, 2):.2f}"
        law = SamplingLaw.periodic(up_to(T).T_max)
        plant = replace(pendulum(up_to(T)), sampling=law)
        gain = ExactMatrix([[1, 0], [0, 1]])
        proved, witness = held(plant, K, [[0, 0]], gain)
        A, B = plant.A.floats, plant.B.floats
        E = exponentials(np.block([[A, B @ ExactMatrix(K).floats], [np.zeros((2, 4))]])[None] * float(T))[0]
        rho = np.abs(np.linalg.eigvals(E[:2, :2] + E[:2, 2:])).max()
        assert proved == (rho < 1) and (witness is not None) == (rho > 1)
        seen.add(rho < 1)
    assert seen == {True, False}


def test_descriptor_design_stabilises_beyond_its_lmi():
    K = descriptor_design(np.array([[0.0, 1], [-1, 0]]), np.array([[0.0], [1]]), 0.3, 1.0)
    assert K is not None
    rounded = [[f"{v:.4f}" for v in K[0]]]
    proved, witness = held(pendulum(up_to("0.3")), rounded, [[0, 0]], ExactMatrix([[1, 0], [0, 1]]))
    assert proved and witness is None


def test_feedback_matrices_agree_with_the_width_and_midpoint():
    """The width of zeta does not depend on the feedback; its midpoint moves with Q0 + Q1 + S B (K_lower + K_upper)."""
    f = floats(*PENDULUM)
    B, low, up = np.array([[0.0], [1]]), np.array([[-0.125, -0.125]]), np.array([[-0.0625, -0.0625]])
    loop = observer_loop(f, f.S @ B, low, up)
    F = loop.Phi_0 + loop.Phi_2
    difference, total = np.hstack([-np.eye(2), np.eye(2)]), np.vstack([np.eye(2), np.eye(2)])
    assert np.allclose(difference @ F, width_of(f) @ difference)
    assert np.allclose(F @ total, np.vstack([f.Q0 + f.Q1 + f.S @ B @ (low + up)] * 2))


@pytest.mark.parametrize(
    ("Mtot", "w_star"),
    [([[1]], [[1]]), ([[-1]], [[-1]]), *(([[-1, 0], [0, 1]], [[1], [second]]) for second in (-1, 0, 1))],
)
def test_what_is_no_witness_of_a_hurwitz_matrix_proves_nothing(Mtot, w_star):
    assert prove_hurwitz(Matrix.from_rows(Mtot), Matrix.from_rows(w_star)) is None


def test_the_rate_of_a_witness_is_that_of_its_slowest_row():
    assert prove_hurwitz(Matrix.from_rows([[-3, 0], [0, -2]]), Matrix.from_rows([[1], [1]])) == 2
    assert prove_hurwitz(Matrix.from_rows([[-2, 0], [0, -3]]), Matrix.from_rows([[1], [1]])) == 2


def test_the_final_width_of_x_takes_every_part_of_z_for_its_worst():
    """S^-1 = [1 0; -1 1]: x2 = z2 - z1 is as uncertain as both together."""
    z = exact([["1.5", "1.5"], ["-1.6", "-1.6"]], [[1, 0]], [[1, 0], [1, 1]], [[2], [-2]])
    w = np.linalg.solve([[2, -1.5], [0, 0.1]], [1 + 2 * 0.2, 1 + 1])
    width = final_width(z, width_of(z), Matrix.from_rows([[1], [1]]), Matrix.from_rows([[Fraction(1, 5)]]))
    assert np.allclose(width.floats.ravel(), [w[0], w[0] + w[1]])
