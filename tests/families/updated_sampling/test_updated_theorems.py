"""Andrieu2014 against its printed numbers, brute force, and the numbers of closed forms."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pytest
from flint import arb, fmpq
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from cdobs_cli.certify.ball import spectral_radius_lower, spectral_radius_upper
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.families.updated_sampling.domination import largest_growth, proves_ii
from cdobs_cli.families.updated_sampling.paper_search import largest_alpha
from cdobs_cli.families.updated_sampling.period import Timing, float_period, guaranteed_period, lemma_1
from cdobs_cli.families.updated_sampling.theorem_2 import alpha_m
from cdobs_cli.families.updated_sampling.theorems import (
    Chain,
    deadbeat_gain,
    held,
    one_step_map,
    sign_corners,
    solvable_i,
    theorem_2_a_2,
    theorem_2_a_2_least,
    theorem_2_prime_i,
)


def radius(K: tuple[int, int], alpha: fmpq) -> float:
    Q = one_step_map(Chain.exact(2), Matrix.from_rows([[K[0]], [K[1]]]), alpha)
    assert float(spectral_radius_upper(Q)) == pytest.approx(float(spectral_radius_lower(Q)), rel=1e-3)
    return float(spectral_radius_lower(Q))


def test_the_one_step_map_of_the_printed_gain_and_its_repairs():
    assert radius((-2, 1), fmpq(9, 10)) == pytest.approx(1.5321, abs=5e-5)
    assert radius((-2, -1), fmpq(9, 10)) == pytest.approx(1.25, abs=5e-3)
    assert radius((-2, -1), fmpq(1, 2)) < 1
    repaired = one_step_map(Chain.exact(2), Matrix.from_rows([[-1], [fmpq(-1, 4)]]), fmpq(9, 10))
    assert float(spectral_radius_upper(repaired)) < 1


def test_the_one_step_map_is_schur_up_to_its_closed_limit():
    limit = 2 * math.sqrt(2) - 2
    K = np.array([[-2.0], [-1.0]])
    for alpha, inside in ((limit - 1e-3, True), (limit + 1e-3, False)):
        eigenvalues = np.linalg.eigvals(one_step_map(Chain.floats(2), K, alpha))
        assert bool(np.abs(eigenvalues).max() < 1) is inside


def test_exp_of_the_chain_is_the_exponential():
    for n in (1, 3, 6):
        assert np.allclose(Chain.floats(n).exp(0.7), expm(0.7 * np.eye(n, k=1)))


@pytest.mark.parametrize(("alpha", "a_2"), [(1.0, 4.1127), (0.5, 3.4085), (0.1, 2.8547)])
def test_closed_form_for_two_states(alpha, a_2):
    P = np.diag([1.0, alpha**2 / (math.e**2 - 1)])
    assert largest_growth(P, alpha, "triangular") / 2 == pytest.approx(a_2, abs=5e-5)
    K = deadbeat_gain(Chain.floats(2), P, alpha, np.linalg.solve)
    assert K.ravel() == pytest.approx([-1 / alpha, -(1 - math.exp(-2)) / alpha**2])
    # a_1 alpha < 1 - e^(-1/2): 0.39 leaves room, 0.394 none.
    for a_1_alpha, holds in ((0.39, True), (0.394, False)):
        gap = theorem_2_prime_i(Chain.floats(2), P, K, alpha, a_1_alpha / alpha, 0.0)
        assert bool(np.linalg.eigvalsh(gap)[0] > 0) is holds
        assert bool(solvable_i(Chain.floats(2), P, alpha, a_1_alpha, 0.0)[0, 0] > 0) is holds


def test_sign_corners_are_enough():
    rng = np.random.default_rng(1)
    for n in (2, 3):
        A = rng.normal(size=(n, n))
        P = A @ A.T + 0.1 * np.eye(n)
        entries = [(i, j) for i in range(n) for j in range(i + 1)]
        brute = 0.0
        for tau in (0.0, 0.35, 0.7):
            P_tau = held(Chain.floats(n), P, tau)
            inverse = np.linalg.inv(np.linalg.cholesky(P_tau))
            best = []
            for corners in (
                (dict(zip(entries, signs, strict=True)) for signs in product((1.0, -1.0), repeat=len(entries))),
                ({(i, j): float(G[i][j]) for i, j in entries} for G in sign_corners(n)),
            ):
                values = []
                for corner in corners:
                    G = np.array([[corner.get((i, j), 0.0) for j in range(n)] for i in range(n)])
                    values.append(np.linalg.eigvalsh(inverse @ (P_tau @ G + G.T @ P_tau) @ inverse.T)[-1])
                best.append(max(values))
            assert best[0] == pytest.approx(best[1], rel=1e-9)
            brute = max(brute, best[0])
        assert largest_growth(P, 0.7, "triangular") >= brute * (1 - 1e-3)
    assert len(list(sign_corners(6))) == 2**11


@pytest.mark.parametrize("variant", ["triangular", "last_row"])
@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_domination_is_proved_just_above_the_float_value_and_not_below(n, variant):
    P = np.diag(0.3 ** np.arange(n))
    g = largest_growth(P, 0.5, variant)
    exact = Matrix.from_floats(P)
    assert proves_ii(exact, fmpq(1, 2), fmpq(int(1.002 * g * 10**6), 10**6), variant)
    assert not proves_ii(exact, fmpq(1, 2), fmpq(int(0.999 * g * 10**6), 10**6), variant)


def test_last_row_growth_dominates_sampled_slopes():
    rng = np.random.default_rng(3)
    P = np.array([[1.0, -0.2], [-0.2, 0.3]])
    g = largest_growth(P, 0.8, "last_row")
    worst = 0.0
    for _ in range(4000):
        tau, w, d = rng.uniform(0, 0.8), rng.normal(size=2), rng.normal(size=2)
        P_tau = held(Chain.floats(2), P, tau)
        delta = np.array([0.0, np.dot(d / np.linalg.norm(d), w)])
        worst = max(worst, 2 * w @ P_tau @ delta / (w @ P_tau @ w))
    assert 0.9 * g < worst <= g * (1 + 1e-9)


def simulated_period(timing: Timing, c: float) -> float:
    """The period after many cycles of (6)-(7), by integration."""
    L = 1.0
    delta = 0.0
    for _ in range(400):

        def event(t: float, z: np.ndarray) -> float:
            return t * math.exp(z[0]) - timing.alpha

        event.terminal = True  # type: ignore[attr-defined]
        solution = solve_ivp(
            lambda t, z: [timing.a_2 * math.exp(timing.a_3 * c * t) * c],
            (0, timing.alpha),
            [math.log(L)],
            events=event,
            rtol=1e-10,
            atol=1e-12,
        )
        delta, before = solution.t[-1], math.exp(solution.y[0, -1])
        L = before * (1 - timing.a_1 * timing.alpha) + timing.a_1 * timing.alpha
    return delta


@pytest.mark.parametrize("a_3", [0.0, 2.0])
def test_the_guaranteed_period_is_that_of_the_cycle(a_3):
    timing = Timing(0.7, 0.5, 2.0, a_3)
    exact = Timing(arb("0.7"), arb("0.5"), arb(2), arb(a_3))
    proved, reached = guaranteed_period(exact, arb("1.3"))
    assert proved < reached
    assert float(proved) == pytest.approx(float(reached), rel=1e-9)
    assert float(proved) == pytest.approx(simulated_period(timing, 1.3), rel=1e-6)
    assert float(proved) == pytest.approx(float_period(timing, 1.3), rel=1e-9)
    assert lemma_1(exact, arb("1.3")) < proved


def test_the_period_times_c_tends_to_its_limit_and_scales():
    timing = Timing(1.0, 0.39, 4.1127, 0.0)
    assert 1e7 * float_period(timing, 1e7) == pytest.approx(-math.log(1 - 0.39) / 4.1127, rel=1e-4)
    assert float_period(timing, 0.0) == pytest.approx(1.0)
    periods = [float_period(timing, c) for c in (0.1, 1.0, 10.0)]
    assert periods == sorted(periods, reverse=True)


def test_lemma_1_is_far_below():
    exact = Timing(arb(1), arb("0.39"), arb("4.1127"), arb(0))
    assert 1e-5 < float(lemma_1(exact, arb(1))) < 1e-4


def test_alpha_m_is_where_the_inequality_is_lost():
    P = Matrix.from_rows([[fmpq(2), fmpq(-7, 10)], [fmpq(-7, 10), fmpq(16, 10)]])
    K = Matrix.from_rows([[fmpq(-3, 2)], [fmpq(-6, 5)]])
    found = alpha_m(P, K, fmpq(1, 20), fmpq(5, 2))
    assert found is not None and found[1] is not None
    below, above = found
    assert 0 < above - below < 1e-6
    assert float(below) == pytest.approx(largest_alpha(P.floats, K.floats, 0.05, 2.5), rel=1e-8)


def test_step_3_needs_the_factor_n_and_less_than_the_paper_takes():
    # (N_1 + N_2 (q - 1)) <= (a_2 p_3 p_1 / (2 n)) (q + 1) for all q >= 1.
    for N_1, N_2, n, footnote in ((3.0, 1.0, 2, True), (1.0, 4.0, 3, False)):
        least, printed = theorem_2_a_2_least(n, N_1, N_2, 1.0, 1.0, max), theorem_2_a_2(n, N_1, N_2, 1.0, 1.0)
        assert least <= printed
        q = np.concatenate([np.linspace(1, 100, 20001), [1e6]])
        grown = N_1 + N_2 * (q - 1)
        tried = (least, 0.999 * least, printed / n)
        holds = [bool(np.all(grown <= a_2 / (2 * n) * (q + 1) + 1e-9)) for a_2 in tried]
        assert holds == [True, False, footnote]
