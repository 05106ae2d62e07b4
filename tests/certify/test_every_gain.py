from dataclasses import replace

import numpy as np
import pytest
from example_inclusions import canonical, impulsive, periodic, plant

from cdobs_cli.certify.floats import exponentials
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.planar.every_gain import CellsOfGains, _powers, _traces
from cdobs_cli.certify.methods.planar.extremals import limit_any_gain, planar_class
from cdobs_cli.exact.numbers import Exact, decimal_text


def asked(c, T, effort=0):
    return Question(impulsive(canonical(c, periodic(T)), [["0"], ["0"]]), effort=effort)


def test_pendulum_class_is_lost_by_every_gain_just_above_the_limit():
    """Proved for one gain at 1.7130, lost by all at 1.7131: the limit is 1.713057."""
    lost = CellsOfGains.propose(asked([1, 0], "1.7131", 1))
    assert lost.prove(asked([1, 0], "1.7131")).holds
    assert not lost.prove(asked([1, "0.001"], "1.7131")).holds, "the words are not of that class"
    assert CellsOfGains.propose(asked([1, 0], "1.7130")) is None
    assert CellsOfGains.propose(asked([1, 0], "0.6")) is None


@pytest.mark.parametrize("seed", range(5))
def test_random_pairs(seed):
    rng = np.random.default_rng(100 + seed)
    c = [decimal_text(float(x), 3) for x in 10 ** rng.uniform(-1.5, 1.0, 2)]
    family, _ = planar_class(asked(c, "1").inclusion)
    limit = limit_any_gain(family, 4.0 / max(float(c[1]), float(c[0]) ** 0.5))
    proved = Exact(decimal_text(limit * 0.9999, 8))
    lost = CellsOfGains.just_above(asked(c, str(proved), 1))
    assert limit < float(lost.law.T_max) < 1.001 * limit
    assert lost.prove(asked(c, str(proved))).holds
    assert not replace(lost, law=periodic(str(proved))).prove(asked(c, str(proved))).holds
    assert CellsOfGains.propose(asked(c, str(proved))) is None


def test_an_edited_certificate_proves_nothing():
    question = asked([1, 0], "1.72", 1)
    lost = CellsOfGains.propose(question)
    cells, (length, *ends) = lost.cells.split(), lost.words[-1][0][0]
    other = [[[[length, 1 - ends[0], ends[1]], *lost.words[-1][0][1:]], *lost.words[-1][1:]]]
    first = next(place for place, text in enumerate(cells) if text != "-")
    edited = [
        replace(lost, cells=" ".join(cells[:-1])),
        replace(lost, cells=lost.cells + " 0"),
        replace(lost, cells=" ".join([*cells[:first], str(len(lost.words)), *cells[first + 1 :]])),
        replace(lost, cells=" ".join([*cells[:first], "-1", *cells[first + 1 :]])),
        replace(lost, cells=" ".join("0" if text != "-" else text for text in cells)),
        replace(lost, cells=""),
        replace(lost, words=[*lost.words[:-1], *other]),
        replace(lost, words=[*lost.words[:-1], [[["1.72", 2, 0]]]]),
        replace(lost, words=[*lost.words[:-1], [[["0.86", 0, 0]]]]),
        replace(lost, words=[]),
    ]
    assert lost.prove(question).holds
    assert not any(one.prove(question).holds for one in edited)


def test_the_traces_are_those_of_the_matrices():
    rng = np.random.default_rng(5)
    for W in range(1, 5):
        words, x, K_2 = rng.normal(size=(3, W, 2, 2)), rng.normal(size=4), rng.normal(size=4)
        found = _traces(words) @ _powers(x, K_2)
        for k, word in enumerate(words):
            for point in range(4):
                M = np.eye(2)
                for Phi in word:
                    M = np.array([[x[point], 0], [-K_2[point], 1]]) @ Phi @ M
                assert found[k, point] == pytest.approx(np.trace(M), abs=1e-9)


def test_where_the_argument_does_not_apply():
    zero = [[0, 0], [0, 0]]
    hidden = impulsive(plant(zero, zero, zero, [[0, 1]], periodic("1")), [["0"], ["0"]])
    assert CellsOfGains.propose(Question(hidden)) is None
    linear = impulsive(plant([[0, 1], [0, 0]], zero, zero, [[1, 0]], periodic("9")), [["0"], ["0"]])
    assert CellsOfGains.propose(Question(linear)) is None  # K = (1, 1/9) stops it


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
