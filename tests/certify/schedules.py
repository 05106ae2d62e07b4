"""Random linear plants with sensors at random periods, and the limit of their monodromy by numpy and scipy alone."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from example_inclusions import impulsive, plant
from scipy.linalg import expm

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.counterexample import Counterexample
from cdobs_cli.certify.methods.spectral import SpectralRadius
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import Sensor

F = Fraction


def without_gain(made_of: Plant) -> Question:
    rows, columns = made_of.gain_shape
    return Question(impulsive(made_of, [["0"] * columns] * rows), effort=1)


def random_schedule(seed: int) -> Question:
    """A plant of 2 to 4 states, 1 to 3 sensors, and gains of a Kalman filter over the hyperperiod at T = 0.2."""
    rng = np.random.default_rng(seed)
    n, count = int(rng.integers(2, 5)), int(rng.integers(1, 4))
    A = [[decimal_text(float(v), 3) for v in row] for row in rng.standard_normal((n, n))]
    C = [[decimal_text(float(v), 3) for v in row] for row in rng.standard_normal((count, n))]
    every = [1, *(F(int(rng.integers(2, 9)), 2) for _ in range(count - 1))]
    offsets = [0, *(one * F(int(rng.integers(0, 4)), 4) for one in every[1:])]
    if count == 1:  # one sensor in step is the simple case: here it is read by turns with a second row
        C, every, offsets, count = [*C, C[0][::-1]], [1, 1], [0, F(1, 2)], 2
    if all(one == 1 for one in every) and not any(offsets):
        offsets[-1] = F(1, 4)
    sensors = [
        Sensor(f"s{k}", (k,), F(one), F(offset)) for k, (one, offset) in enumerate(zip(every, offsets, strict=True))
    ]
    zero = [[0] * n for _ in range(n)]
    return without_gain(plant(A, zero, zero, C, SamplingLaw.multirate(Exact("0.2"), sensors)))


def filtered(question: Question) -> Question:
    """With the gains of the filter, R = I, Q = I per time, after many hyperperiods."""
    flow, scheme, n = question.plant.A.floats, question.law, question.plant.n
    P, K = np.eye(n), []
    for _ in range(60):
        K = []
        for phase in scheme.phases:
            C = question.plant.C.floats[list(phase.outputs)]
            gain = P @ C.T @ np.linalg.inv(C @ P @ C.T + np.eye(len(C)))
            K.append(gain)
            P = (np.eye(n) - gain @ C) @ P
            Phi = expm(flow * float(phase.gap) * 0.2)
            P = Phi @ P @ Phi.T + np.eye(n) * float(phase.gap) * 0.2
    return question.with_gain({"K": ExactMatrix.from_floats(np.hstack(K), 5)})


def radius(question: Question, T: float) -> float:
    """rho of the error over a hyperperiod, by numpy and scipy alone."""
    K, n, first = question.gain("K").floats, question.plant.n, 0
    M, jumps = np.eye(n), []
    for phase in question.law.phases:
        C = question.plant.C.floats[list(phase.outputs)]
        jumps.append(np.eye(n) - K[:, first : first + len(C)] @ C)
        first += len(C)
    gaps = [phase.gap for phase in question.law.phases]
    flows = {gap: expm(question.plant.A.floats * float(gap) * T) for gap in set(gaps)}
    for k, gap in enumerate(gaps):
        M = jumps[(k + 1) % len(jumps)] @ flows[gap] @ M
    return float(np.abs(np.linalg.eigvals(M)).max())


def limit(question: Question) -> float | None:
    """The first T above 0.2 at which rho reaches 1; None up to 3."""
    grid = 0.2 * np.exp(np.arange(0, np.log(15), 0.004))
    above = next((k for k, T in enumerate(grid) if radius(question, T) >= 1), None)
    if above is None or above == 0:
        return None
    low, high = grid[above - 1], grid[above]
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if radius(question, middle) < 1 else (low, middle)
    return float(high)


def is_met(seed: int) -> bool:
    """Whether a schedule has a limit, which is then proved and refuted within half a percent of it. Raises:
    AssertionError."""
    question = filtered(random_schedule(seed))
    end, proved = limit(question), SpectralRadius.longest(question)
    if end is None:
        return False
    assert proved is not None and proved.prove(question).holds, seed
    refuted = Counterexample.shortest(question, proved.law.period)
    assert refuted is not None and refuted.prove(question).holds, seed
    assert 0.995 * end <= float(proved.law.period) <= end * (1 + 1e-9), seed
    assert end * (1 - 1e-9) <= float(refuted.law.period) <= 1.005 * end, seed
    assert not SpectralRadius(refuted.law, "0").prove(question).holds, seed
    return True
