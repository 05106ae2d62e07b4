"""The paper's two plants, built directly."""

import numpy as np

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.exact.expression import ZERO
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.interval import Gain, Interval
from cdobs_cli.families.interval.observer import inclusion
from cdobs_cli.families.interval.theorems import Coordinates, coordinates
from cdobs_cli.plant import Box, Input, Plant, Slopes
from cdobs_cli.sampling import SamplingLaw


def box(lower, upper):
    return Box(tuple(map(Exact, lower)), tuple(map(Exact, upper)))


def plant(A, C, law, B=None, disturbance=None, noise=None):
    n = len(A)
    zeros = ExactMatrix([[0] * n] * n)
    inputs = tuple(Input(f"u{k}") for k in range(len(B[0]))) if B else ()
    return Plant(
        tuple(f"x{i + 1}" for i in range(n)), inputs, ExactMatrix(A), (ZERO,) * n, ExactMatrix(B) if B else None,
        ExactMatrix(C), Slopes(zeros, zeros), law, disturbance=disturbance, noise=noise,
    )  # fmt: skip


def up_to(T, low="0"):
    return SamplingLaw("aperiodic", Exact(low), Exact(T))


def scalar(law, a="1", v="0.1"):
    return plant([[a]], [[1]], law, B=[[1]], disturbance=box(["-0.1"], ["0.1"]), noise=box([f"-{v}"], [v]))


def pendulum(law):
    return plant(
        [[0, 1], [-1, 0]], [[1, 0]], law, B=[[0], [1]],
        disturbance=box(["-0.5", "-0.5"], ["0.5", "0.5"]), noise=box(["-0.1"], ["0.1"]),
    )  # fmt: skip


PENDULUM_S = ExactMatrix([["sqrt(2)", 0], [-1, 1]])
PENDULUM_L = ExactMatrix([[4], [4]])
PRINTED = Gain(S=PENDULUM_S, L=PENDULUM_L)


def exact(A, C, S, L) -> Coordinates:
    A, C, S, L = (m if isinstance(m, ExactMatrix) else ExactMatrix(m) for m in (A, C, S, L))
    return coordinates(A.balls(), C.balls(), S.balls(), S.balls().inverse(), L.balls())


def floats(A, C, S, L) -> Coordinates:
    A, C, S, L = (m if isinstance(m, ExactMatrix) else ExactMatrix(m) for m in (A, C, S, L))
    return coordinates(A.floats, C.floats, S.floats, np.linalg.inv(S.floats), L.floats)


def question(plant, gain, **options) -> Question:
    """What a certificate of this gain is asked under the plant's law."""
    return Question(inclusion(plant, gain), card=Interval(**options))


def asked(A, C, S, L, T="1", **gain) -> Question:
    """The same of typed matrices, for periods up to T."""
    typed = {name: m if isinstance(m, ExactMatrix) else ExactMatrix(m) for name, m in {"S": S, "L": L, **gain}.items()}
    return question(plant(A, C, up_to(T), B=[[0]] * (len(A) - 1) + [[1]]), typed)


PENDULUM = ([[0, 1], [-1, 0]], [[1, 0]], PENDULUM_S, PENDULUM_L)
SCALAR = ([[1]], [[1]], [[1]], [["1.4"]])
