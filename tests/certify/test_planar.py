from fractions import Fraction

import numpy as np
import pytest
from asking import analyse_by, proves
from example_inclusions import canonical, impulsive, periodic, plant

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.floats import exponentials
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.design import ImpulsiveGain
from cdobs_cli.certify.methods.planar.extremals import Planar, best_gain, limit_any_gain, planar_class, switching
from cdobs_cli.certify.words import Arc, Word, prove
from cdobs_cli.exact.numbers import Exact, decimal_text


def pendulum(T, K_2="0.69445", K_1="1"):
    return impulsive(canonical([1, 0], periodic(T)), [[K_1], [K_2]])


def test_pendulum_slope_class():
    """The root of sinh(delta - s) = sin s, s = acot(tanh(delta / 2)) is 1.713057392453498 (theory note)."""
    family, _ = planar_class(pendulum("1"))
    assert limit_any_gain(family, 3.0) == pytest.approx(1.713057392453498, rel=1e-10)
    assert float(best_gain(pendulum("1.71305"))) == pytest.approx(np.tanh(1.71305 / 2), abs=1e-5)
    assert analyse_by(Planar, pendulum("1.7130")) is not None
    assert analyse_by(Planar, pendulum("1.71306", "0.694465")) is None
    assert analyse_by(Planar, pendulum("1.7130", "0.6940")) is None
    assert analyse_by(Planar, pendulum("1.2", K_1="0.99")) is None  # another theorem's business


def words(inclusion, delta):
    """Both extremals as words of the falsifier."""
    family, b = planar_class(inclusion)
    _, _, first, second = family.floats(float(delta)).gains()
    slopes = inclusion.plant.slopes
    for s in (first, second):
        s = min(Fraction(decimal_text(s, 12)), delta)
        arcs = switching(family, b, s, delta)
        values = [
            tuple((slopes.upper if ends[j] else slopes.lower)[i, j] for i, j in inclusion.entries) for _, ends in arcs
        ]
        yield Word((tuple(Arc(Exact(length), v) for (length, _), v in zip(arcs, values, strict=True)),))


@pytest.mark.parametrize("seed", range(4))
def test_random_canonical_pairs_are_bracketed_to_a_tenth_of_a_per_cent(seed):
    rng = np.random.default_rng(seed)
    c = [decimal_text(float(x), 3) for x in 10 ** rng.uniform(-1.5, 1.0, 2)]
    family, _ = planar_class(impulsive(canonical(c, periodic("1")), [["1"], ["1"]]))
    limit = limit_any_gain(family, 4.0 / max(float(c[1]), float(c[0]) ** 0.5))
    below, above = decimal_text(limit * 0.9997, 8), decimal_text(limit * 1.0003, 8)
    K_2 = decimal_text(float(best_gain(impulsive(canonical(c, periodic(below)), [["1"], ["1"]]))), 7)
    inclusion = impulsive(canonical(c, periodic(below)), [["1"], [K_2]])
    certificate = analyse_by(Planar, inclusion)
    assert certificate is not None
    assert proves(inclusion, Certificate.from_document(certificate.document()))
    # Brute force: random switching in 24 slots stays inside.
    maps = inclusion.floats
    corners = exponentials(np.array(list(maps.corners())) * float(below) / 24)
    for _ in range(300):
        M = np.eye(2)
        for k in rng.integers(0, 4, 24) if rng.random() < 0.5 else np.repeat(rng.integers(0, 4, 4), 6):
            M = corners[k] @ M
        assert abs(M[1, 1] - float(K_2) * M[0, 1]) < 1
    # Just above, one of the two extremals defeats the gain.
    beyond = impulsive(canonical(c, periodic(above)), [["1"], [K_2]])
    assert any(prove(beyond, word) is not None for word in words(beyond, Fraction(above)))
    assert analyse_by(Planar, beyond) is None


def test_unequal_slopes_and_a_reversed_chain():
    """A = [[0, -2], [1/10, -1/5]], slopes in [-1/2, 3/10] and [-1/5, 2/5]: the clock stays below the limit."""

    def made(T, K_2="0"):
        A, lower, upper = [[0, -2], ["0.1", "-0.2"]], [[0, 0], ["-0.5", "-0.2"]], [[0, 0], ["0.3", "0.4"]]
        return impulsive(plant(A, lower, upper, [[1, 0]], periodic(T)), [["1"], [K_2]])

    family, _ = planar_class(made("1"))
    limit = limit_any_gain(family, 6.0)
    by_clock = ImpulsiveGain().longest(Question(made("0.3")))
    assert 0.85 * limit < float(by_clock.law.T_max) < limit
    below, above = decimal_text(limit * 0.9997, 8), decimal_text(limit * 1.0003, 8)
    K_2 = decimal_text(float(best_gain(made(below))), 8)
    assert analyse_by(Planar, made(below, K_2)) is not None
    assert analyse_by(Planar, made(above, K_2)) is None
    assert any(prove(made(above, K_2), word) is not None for word in words(made(above, K_2), Fraction(above)))


def test_decay_rate():
    """With zero slopes and K = (1, 1/2) the map is 1 - delta / 2: at delta = 1 the rate is ln 2 exactly."""
    tiny = "0.000001"
    inclusion = impulsive(canonical([tiny, 0], periodic(1)), [["1"], ["0.5"]])
    assert analyse_by(Planar, inclusion, sigma=Fraction("0.6931")) is not None
    assert analyse_by(Planar, inclusion, sigma=Fraction("0.6932")) is None
