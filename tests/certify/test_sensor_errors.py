"""How large errors stay with sensors of different periods: what is proved against what is attained, computed apart."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from example_inclusions import impulsive, plant
from flint import arb
from scipy.linalg import expm, solve_discrete_lyapunov

from cdobs_cli.certify.accuracy import sized
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.graph_size import GraphMeanSquare, GraphPeak
from cdobs_cli.certify.methods.response import Cell, Loop, MeanSquareResponse, PeakResponse, error_sizes
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.hybrid import corrected_copy_noise
from cdobs_cli.plant import Box, Slopes
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import Gains, Sensor

F = Fraction
# x every 0.1, theta every 0.4, and gains of the theory: measurement schemes, (a).
CART = [[0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1], [0, 0, "10/3", 0]]
BOTH = [["1", "0"], ["5", "-.0816"], ["0", "1"], [".0178", "2.7949"]]
ALONE = [["1"], ["10"], ["-.1505"], ["-1.5079"]]
PENDULUM_GAINS = [["0.9", "0.8"], ["1.2", "0.7"]]  # of the angle every 0.6, and of the rate 0.3 later


def box(*sizes: Any) -> Box:
    return Box(tuple(-Exact(one) for one in sizes), tuple(Exact(one) for one in sizes))


def law(T: Any, *sensors: tuple[tuple[int, ...], Any, Any], gains: Gains = "by_phase") -> SamplingLaw:
    named = [Sensor(f"s{k}", outputs, F(every), F(offset)) for k, (outputs, every, offset) in enumerate(sensors)]
    return SamplingLaw.multirate(Exact(T), named, gains)


def noisy(question: Question, **declared: Any) -> Question:
    inclusion = replace(
        question.inclusion, plant=replace(question.plant, **declared), assemble_noise=corrected_copy_noise
    )
    return replace(question, inclusion=inclusion)


def cart(**declared: Any) -> Question:
    zero, C = [[0] * 4 for _ in range(4)], [[1, 0, 0, 0], [0, 0, 1, 0]]
    K = [[*both, *alone * 3] for both, alone in zip(BOTH, ALONE, strict=True)]
    return noisy(Question(impulsive(plant(CART, zero, zero, C, law("0.1", ((0,), 1, 0), ((1,), 4, 0))), K)), **declared)


def pendulum(low: Any, high: Any, **declared: Any) -> Question:
    """theta'' in [low, high] theta, the rate read half a period after the angle."""
    lower, upper = [[0, 0], [low, 0]], [[0, 0], [high, 0]]
    made = plant([[0, 1], [0, 0]], lower, upper, [[1, 0], [0, 1]], law("0.6", ((0,), 1, 0), ((1,), 1, "1/2")))
    return noisy(Question(impulsive(made, PENDULUM_GAINS)), **declared)


def flow(question: Question, v: float = 0.0) -> Any:
    """A with the slopes that are constant, the others at v."""
    lower, upper = question.plant.slopes.lower.floats, question.plant.slopes.upper.floats
    return question.plant.A.floats + np.where(lower == upper, lower, v)


def pieces(question: Question, v: float = 0.0, steps: int = 40) -> list[tuple[Any, Any, Any]]:
    """Of each sample of a hyperperiod J and K, and the flow over a step of the gap after it, by numpy alone."""
    made, scheme = question.plant, question.law
    A = flow(question, v)
    split = scheme.split(question.gain("K"), made.p)
    gaps = [float(gap) for gap in scheme.gaps]
    return [
        (np.eye(made.n) - K.floats @ made.C.floats, K.floats, (expm(A * gap / steps), gap / steps))
        for K, gap in zip(split, gaps, strict=True)
    ]


def largest_error(question: Question, v: float = 0.0, steps: int = 12) -> Any:
    """sup |e_i| at one slope: each past noise and disturbance with the sign that its response has, seen at every step.
    Of disturbances the least that a step may come to, so no more than what is attained."""
    made, of = question.plant, pieces(question, v, steps)
    v0 = np.zeros(made.p) if made.noise is None else np.array(made.noise.float_sizes)
    d0 = np.zeros(made.n) if made.disturbance is None else np.array(made.disturbance.float_sizes)
    most, n = np.zeros(made.n), made.n
    A = flow(question, v)

    def over(h: float) -> Any:
        return expm(np.block([[A, np.eye(n)], [np.zeros((n, 2 * n))]]) * h)[:n, n:]

    for q, s in ((q, s) for q in range(len(of)) for s in range(steps + 1)):
        step, h = of[q][2]
        rows, total = np.linalg.matrix_power(step, s), np.zeros(n)
        for k in range(s):
            total += np.abs(np.linalg.matrix_power(step, k) @ over(h)) @ d0
        for k in range(60 * len(of)):
            J, K, _ = of[(q - k) % len(of)]
            total += np.abs(rows @ K) @ v0
            rows = rows @ J
            back, h = of[(q - k - 1) % len(of)][2]
            integral = over(h)
            for _ in range(steps):
                total += np.abs(rows @ integral) @ d0
                rows = rows @ back
        most = np.maximum(most, total)
    return most


def root_mean_squares(question: Question, steps: int = 40) -> Any:
    """The root of sup E e_i^2 of a linear plant: the covariance that a hyperperiod repeats, at every step of it."""
    made, of = question.plant, pieces(question, steps=steps)
    R = np.zeros((made.p, made.p)) if made.covariance is None else made.covariance.floats
    Q = np.zeros((made.n, made.n)) if made.intensity is None else made.intensity.floats
    A = flow(question)

    def through(Sigma: Any) -> Any:
        """From just before the first sample to just before it again, and the most on the way."""
        most = np.diag(Sigma)
        for J, K, (step, h) in of:
            Sigma = J @ Sigma @ J.T + K @ R @ K.T
            for _ in range(steps):
                most = np.maximum(most, np.diag(Sigma))
                pair = expm(np.block([[-A, Q], [np.zeros_like(A), A.T]]) * h)
                Sigma = step @ Sigma @ step.T + pair[len(A) :, len(A) :].T @ pair[: len(A), len(A) :]
            most = np.maximum(most, np.diag(Sigma))
        return Sigma, most

    M = np.eye(made.n)
    for J, _, (step, _) in of:
        M = np.linalg.matrix_power(step, steps) @ J @ M
    added, _ = through(np.zeros_like(A))
    return np.sqrt(through(solve_discrete_lyapunov(M, added))[1])


BOUNDED = [
    {"noise": box("0.01", "0.005")},
    {"noise": box("0.01", "0.005"), "disturbance": box(0, "0.1", 0, "0.2")},
    {"disturbance": box(0, "0.1", 0, 0)},
]


@pytest.mark.parametrize("declared", BOUNDED)
def test_the_response_of_a_linear_plant_is_nearly_attained(declared: dict[str, Any]) -> None:
    question = cart(**declared)
    exact, sizes = largest_error(question), error_sizes(question.inclusion)
    assert sizes is not None and PeakResponse(question.law, "0").prove(question.of_state(0)).error == sizes.bounds[0]
    bounds = np.array([float(one) for one in sizes.bounds])
    print(bounds / exact)
    assert (bounds >= exact * (1 - 1e-9)).all() and (bounds <= 1.12 * exact).all()


def uneven(low: Any = "-4", high: Any = "-4", **declared: Any) -> Question:
    """An oscillation whose gaps are all different: 0.1, 0.3, 0.4 after the samples of x, v, x."""
    lower, upper = [[0, 0], [low, 0]], [[0, 0], [high, 0]]
    made = plant([[0, 1], [0, "-0.2"]], lower, upper, [[1, 0], [0, 1]], law("0.4", ((0,), 1, 0), ((1,), 2, "1/4")))
    K = [["0.4", "0.1", "0.3"], ["0.2", "0.3", "-0.1"]]
    return noisy(Question(impulsive(made, K)), **declared)


@pytest.mark.parametrize("width", [0.05, 0.4, 3.0])
@pytest.mark.parametrize("signal", range(4))
def test_gains_of_each_signal_are_no_less_than_they_are(signal: int, width: float) -> None:
    """However coarse the cells: |d_j| <= 1, |v_j| <= 1, one at a time, and white ones of variance 1."""
    which = [int(k == signal % 2) for k in range(2)]
    signals = {"disturbance" if signal < 2 else "noise": box(*which)}
    question = uneven(**signals)
    loop = Loop.of(question.inclusion, width, 10**6)
    assert loop is not None
    exact = largest_error(question)
    for turns in (1, 2, 8):
        most = loop.most(turns)
        assert most is not None
        free, gains = (np.array([float(one) for one in most[0]]), most[1].floats[:, signal])
        assert (free >= exact * (1 - 1e-9)).all() and (gains >= exact * (1 - 1e-9)).all()
        assert width > 0.05 or turns < 8 or (free <= 1.1 * exact).all()
    unit = ExactMatrix([[which[0], 0], [0, which[1]]])
    white = uneven(**{"intensity" if signal < 2 else "covariance": unit})
    exact, loop = root_mean_squares(white), Loop.of(white.inclusion, width, 10**6)
    assert loop is not None
    for turns in (1, 2, 8):
        most = loop.most(turns)
        assert most is not None and (np.array([float(one) for one in most[0]]) >= exact * (1 - 1e-9)).all()


def test_what_acts_since_the_last_sample_counts() -> None:
    """The first sample erases all error, the second corrects nothing: what is left came since the first."""
    zero, C = [[0, 0], [0, 0]], [[1, 0], [0, 1], [1, 0]]
    made = plant([[0, 1], [-4, "-0.2"]], zero, zero, C, law("0.4", ((0, 1), 1, 0), ((2,), 1, "1/2")))
    question = noisy(Question(impulsive(made, [[1, 0, 0], [0, 1, 0]])), disturbance=box(0, 1))
    loop = Loop.of(question.inclusion, 3.0, 10**6)
    most = None if loop is None else loop.most(1)
    assert most is not None
    exact = largest_error(question)
    assert (np.array([float(one) for one in most[0]]) >= exact).all() and (most[1].floats[:, 1] >= exact).all()


@pytest.mark.parametrize("h", [0.1, 1.0, 4.0])
def test_what_changes_its_sign_within_a_cell_is_not_taken_off(h: float) -> None:
    rng = np.random.default_rng(0)
    for _ in range(10):
        A, R = rng.standard_normal((3, 3)), rng.standard_normal((2, 3))
        cell = Cell.of(Matrix.from_floats(A), arb(h), None)
        times = (np.arange(400) + 0.5) * h / 400
        exact = sum(np.abs(R @ expm(A * t)) for t in times) * h / 400
        assert (cell.across(Matrix.from_floats(R)).floats >= exact * (1 - 1e-3)).all()


def test_slopes_of_outputs_add_what_they_do() -> None:
    """x is measured with any factor in [0.8, 1.2], constant here."""
    noise = box("0.01", "0.01")
    H = Slopes(ExactMatrix([["0.8", 0], [0, 1]]), ExactMatrix([["1.2", 0], [0, 1]]))
    free = (Exact(0).expression,) * 2
    sizes = error_sizes(uneven(noise=noise, h=free, H=H).inclusion)
    fixed = error_sizes(uneven(noise=noise).inclusion)
    assert sizes is not None and fixed is not None
    for factor in ("0.8", "1.2"):
        at = uneven(noise=noise, C=ExactMatrix([[factor, 0], [0, 1]]))
        assert (np.array([float(one) for one in sizes.bounds]) >= largest_error(at)).all()
    assert all(one > 1.05 * known for one, known in zip(sizes.bounds, fixed.bounds, strict=True))


WHITE = [
    {"covariance": ExactMatrix([["1e-4", 0], [0, "4e-5"]])},
    {"covariance": ExactMatrix([["1e-4", "2e-5"], ["2e-5", "4e-5"]]),
     "intensity": ExactMatrix([[0] * 4, [0, "0.01", 0, 0], [0] * 4, [0, 0, 0, "0.02"]])},
]  # fmt: skip


@pytest.mark.parametrize("declared", WHITE)
def test_mean_squares_of_a_linear_plant_are_those_of_its_covariance(declared: dict[str, Any]) -> None:
    question = cart(**declared)
    exact, sizes = root_mean_squares(question), error_sizes(question.inclusion)
    assert sizes is not None
    bounds = np.array([float(one) for one in sizes.bounds])
    print(bounds / exact)
    assert (bounds >= exact * (1 - 1e-9)).all() and (bounds <= 1.12 * exact).all()


def test_bounded_and_white_signals_add() -> None:
    v, Q = box("0.01", "0.005"), WHITE[1]["intensity"]
    alone = [error_sizes(cart(noise=v).inclusion), error_sizes(cart(intensity=Q).inclusion)]
    both = error_sizes(cart(noise=v, intensity=Q).inclusion)
    assert both is not None
    for i in range(4):
        parts = [float(one.bounds[i]) for one in alone if one is not None]
        assert max(parts) < float(both.bounds[i]) <= sum(parts) * (1 + 1e-9) and len(parts) == 2
    assert MeanSquareResponse.applies(cart(noise=v, intensity=Q)) and not PeakResponse.applies(
        cart(noise=v, intensity=Q)
    )


@pytest.mark.parametrize("kind", [PeakResponse, GraphPeak])
def test_runs_under_slopes_that_vary_stay_below_what_is_proved(kind: Any) -> None:
    """Of what is attained at one of the slopes, and of slopes that switch at random."""
    question = pendulum("-0.1", "0.1", noise=box("0.01", "0.02"), disturbance=box(0, "0.05"))
    proofs = [proposed(kind, question.of_state(i)) for i in range(2)]
    bounds = np.array([float(one) for one in proofs])
    attained = np.maximum(*(largest_error(question, v) for v in (-0.1, 0.1)))
    print(bounds / attained)
    assert (bounds >= attained).all() and (bounds <= 3 * attained).all()
    of = {v: pieces(question, v, 6) for v in (-0.1, 0.1)}
    rng, most = np.random.default_rng(3), np.zeros(2)
    for run in range(60):
        e, signs = np.zeros(2), rng.choice([-1, 1], 3) if run % 2 else None
        for k in range(80):
            J, K, _ = of[0.1][k % 2]
            sign = rng.choice([-1, 1], 3) if signs is None else signs
            e = J @ e + K @ (sign[:2] * [0.01, 0.02])
            for _ in range(6):
                step, h = of[float(rng.choice([-0.1, 0.1]))][k % 2][2]
                e = step @ (e + h * np.array([0, 0.05]) * sign[2])
                most = np.maximum(most, np.abs(e))
    assert (most > 0).all() and (most <= bounds).all()


def proposed(kind: Any, question: Question) -> Any:
    """What the method proves of the question, with nothing said of the response."""
    if issubclass(kind, GraphPeak | GraphMeanSquare):
        guesses = [kind._at(question.with_rate(F(sigma))) for sigma in ("0.1", "0.2", "0.4")]
        errors = [one.prove(question).error for one in guesses if one is not None]
    else:
        one = kind.propose(question)
        errors = [] if one is None else [one.prove(question).error]
    assert errors and None not in errors
    return min(errors, key=float)


def test_a_cycle_bounds_the_errors_of_a_linear_plant_from_above() -> None:
    """Of one quadratic function a sample: 7 to 18 times what is attained, in the mean square 3 to 8."""
    bounded, white = cart(**BOUNDED[1]), cart(**WHITE[1])
    for question, kind, exact, loose in (
        (bounded, GraphPeak, largest_error(bounded), 20.0),
        (white, GraphMeanSquare, root_mean_squares(white), 8.0),
    ):
        errors = np.array([float(proposed(kind, question.of_state(i))) for i in range(4)])
        print(errors / exact)
        assert (errors >= exact * (1 - 1e-3)).all() and (errors <= loose * exact).all()


def test_nothing_is_claimed_where_errors_do_not_decay() -> None:
    signals = BOUNDED[0]
    K = cart().gain("K")
    nothing = ExactMatrix([["0"] * K.shape[1]] * 4)
    for question in (cart(**signals).with_gain({"K": nothing}), cart(**signals).at(Exact("0.22"))):
        assert error_sizes(question.inclusion) is None and not sized(question)
    wide = pendulum("-8", "8", noise=box("0.01", "0.02"))
    assert error_sizes(wide.inclusion) is None and not sized(wide)


def test_slopes_that_vary_more_leave_more_open() -> None:
    v = {"noise": box("0.01", "0.02")}
    narrow, wide = (error_sizes(pendulum(f"-{c}", c, **v).inclusion) for c in ("0.1", "0.3"))
    fixed = error_sizes(pendulum("0", "0", **v).inclusion)
    assert fixed is not None and narrow is not None and wide is not None
    for i in range(2):
        assert fixed.bounds[i] < narrow.bounds[i] < wide.bounds[i]
        assert fixed.bounds[i] == fixed.at_middle[i]


def test_a_cycle_at_rate_0_or_of_another_state_bounds_nothing() -> None:
    question = pendulum("-0.3", "0.3", noise=box("0.01", "0.02"))
    cycle = GraphPeak._at(question.of_state(0).with_rate(F(1, 10)))
    assert cycle is not None and cycle.prove(question).error is not None
    for broken in ({"sigma": "0"}, {"sigma": "9"}, {"state": "2"}, {"state": "-1"}, {"P": cycle.P[:-1]}):
        assert not replace(cycle, **broken).prove(question).holds
    silent = noisy(question, noise=None)
    assert not cycle.prove(silent).holds
    louder = noisy(question, noise=box("0.02", "0.04"))
    errors = [cycle.prove(one).error for one in (question, louder)]
    assert float(errors[1]) == pytest.approx(2 * float(errors[0]))
