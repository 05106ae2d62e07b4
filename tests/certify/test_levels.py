"""Level sets: the proved transient against the worst that random switching finds."""

from dataclasses import replace

import numpy as np
import pytest
from flint import arb
from scipy.linalg import expm
from slope_plants import make_plant

from cdobs_cli.certify.levels import constant_level
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.certificate import Clock
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.plant import Box
from cdobs_cli.sampling import SamplingLaw

PLANT = replace(
    make_plant(("a", "b"), ("0", "sin(a)"), upper=[["0", "0"], ["1", "0"]]),
    A=ExactMatrix([["0", "1"], ["0", "0"]]),
    sampling=SamplingLaw("aperiodic", Exact("0.2"), Exact("0.5")),
)
START = Box((Exact("-0.3"), Exact("0.1")), (Exact("0.2"), Exact("0.4")))

held, impulsive = LpvZeroOrderHold().inclusion, Reachability().inclusion


def worst_met(inclusion, n: int) -> np.ndarray:
    """The largest |e_j| over random corners of the box, switching slopes and periods."""
    random = np.random.default_rng(5)
    maps = inclusion.floats
    dt = 0.05
    steps = [expm(maps.flow((v,)) * dt) for v in (-1.0, 1.0)]
    worst = np.zeros(n)
    for _ in range(60):
        e = np.zeros(len(maps.base))
        e[:n] = [random.choice([float(low), float(high)]) for low, high in zip(START.lower, START.upper, strict=True)]
        for _ in range(12):
            e = maps.jump @ e
            worst = np.maximum(worst, np.abs(e[:n]))
            v = random.integers(2)
            for _ in range(random.integers(4, 11)):
                v = random.integers(2) if random.random() < 0.3 else v
                e = steps[v] @ e
                worst = np.maximum(worst, np.abs(e[:n]))
    return worst


@pytest.mark.parametrize(
    ("make", "gain"),
    [(impulsive, {"K": ExactMatrix([["1"], ["1.5"]])}), (held, {"L": ExactMatrix([["1.8"], ["1.9"]])})],
)
def test_no_error_passes_the_proved_transient(make, gain) -> None:
    asked = Question(make(PLANT, gain))
    certificate = Clock.propose(asked)
    assert certificate is not None
    level = certificate.level(asked)
    assert level is not None
    bounds = np.array([float(bound) for bound in level.bounds(START)])
    met = worst_met(asked.inclusion, 2)
    assert np.all(met <= bounds)
    assert np.all(bounds <= 6 * met)


def test_a_certificate_of_another_gain_shows_nothing() -> None:
    certificate = Clock.propose(Question(impulsive(PLANT, {"K": ExactMatrix([["1"], ["1.5"]])}), effort=0))
    assert certificate is not None
    assert certificate.level(Question(impulsive(PLANT, {"K": ExactMatrix([["0"], ["0"]])}))) is None


def test_the_largest_value_over_a_box_is_at_a_vertex() -> None:
    level = constant_level(ExactMatrix([["2", "-1"], ["-1", "3"]]))
    # At (-0.3, 0.4): 2 * 0.09 + 2 * 0.12 + 3 * 0.16; the inverse is [[3, 1], [1, 2]] / 5.
    assert abs(level.largest(START) - arb("0.9")) < 1e-12
    assert [float(bound) for bound in level.bounds(START)] == pytest.approx(
        [(0.9 * 3 / 5) ** 0.5, (0.9 * 2 / 5) ** 0.5]
    )
