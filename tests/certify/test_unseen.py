"""Plants that no gain can help, and their neighbours that some gain does."""

import math
from dataclasses import replace

import numpy as np
import pytest
from asking import analyse
from example_inclusions import aperiodic, held, impulsive, periodic, plant

from cdobs_cli.certify.floats import exponentials
from cdobs_cli.certify.unseen import unseen
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.simulate.witness import replay

ZERO = [[0, 0], [0, 0]]
OSCILLATOR = [[0, 1], [-1, 0]]
TWO = [[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -9, 0]]  # at rates 1 and 3


def oscillator(law, A=OSCILLATOR, C=((1, 0),)):
    n = len(A)
    return plant(A, [[0] * n] * n, [[0] * n] * n, C, law)


@pytest.mark.parametrize(
    ("law", "A", "C", "T"),
    [
        (periodic("pi"), OSCILLATOR, [[1, 0]], "pi"),
        (periodic("3*pi"), OSCILLATOR, [[1, "0.2"]], "3*pi"),
        (periodic("pi/sqrt(2)"), [[0, 1], [-2, 0]], [[1, 0]], "pi/sqrt(2)"),
        (periodic(2), [[0, "pi"], ["-pi", 0]], [[1, 0]], "2"),
        (periodic(1), [[0, "pi"], ["-pi", 0]], [["sqrt(2)", 0]], "1"),
        (aperiodic(0, 4), OSCILLATOR, [[1, 0]], "pi"),
        (aperiodic(4, 7), OSCILLATOR, [[1, 0]], "2*pi"),
        (aperiodic("0.5", "1.5"), [[0, "pi"], ["-pi", 0]], [[1, 0]], "1"),
        (periodic("pi"), [["0.1", 1], [-1, "0.1"]], [[1, 0]], "pi"),  # it grows by exp(pi/10)
        (periodic("pi/2"), TWO, [[1, 0, 1, 0]], "pi/2"),  # exp(i T) and exp(3 i T) are conjugate
        (
            periodic("2*pi"),
            [[0, 1, 0], [-1, 0, 0], [0, 0, 0]],
            [[1, 0, 1]],
            "2*pi",
        ),  # a constant looks like a full turn
    ],
)
def test_pathological_sampling(law, A, C, T):
    made = oscillator(law, A, C)
    found = unseen(made)
    assert float(found.period) == pytest.approx(float(Exact(T)), abs=1e-12)
    direction = np.array([float(x) for x in found.direction])
    Phi = exponentials(made.A.floats[None] * float(found.period))[0]
    error, size = direction, np.linalg.norm(direction)
    for _ in range(6):
        assert np.abs(made.C.floats @ error).max() < 1e-9 * size
        error = Phi @ error
        assert np.linalg.norm(error) > 0.4 * size
    assert np.linalg.norm(Phi @ Phi @ error) > (1 - 1e-9) * size
    assert found.witness(made).kind == "vector"
    gain = np.linalg.pinv(made.C.floats)
    for loop in (impulsive(made, gain.round(3).tolist()), held(made, gain.round(3).tolist())):
        assert analyse(loop, 0) is None


@pytest.mark.parametrize(
    ("law", "A", "C"),
    [
        (periodic("3"), OSCILLATOR, [[1, 0]]),
        (periodic("pi/2"), OSCILLATOR, [[1, 0]]),
        (periodic("3.14159265358979323846"), OSCILLATOR, [[1, 0]]),
        (periodic("pi"), OSCILLATOR, [[1, 0], [0, 1]]),  # both states are measured
        (periodic("pi"), [["-0.1", 1], [-1, "-0.1"]], [[1, 0]]),  # unseen, but it decays
        (aperiodic(0, "3.14"), OSCILLATOR, [[1, 0]]),
        (aperiodic("3.15", "6.28"), OSCILLATOR, [[1, 0]]),
        (aperiodic("3.1415926536", "4"), OSCILLATOR, [[1, 0]]),
        (periodic("pi/5"), TWO, [[1, 0, 1, 0]]),
        (periodic("pi/2"), TWO, [[1, 0, 0, 0], [0, 0, 1, 0]]),
        (periodic("pi"), [[0, 1, 0], [-1, 0, 0], [0, 0, 0]], [[1, 0, 1], [0, 1, 0]]),
    ],
)
def test_sampling_that_is_not(law, A, C):
    assert unseen(oscillator(law, A, C)) is None


@pytest.mark.parametrize("law", [periodic("0.3"), aperiodic(0, "0.3"), periodic("pi")])
def test_states_that_never_show(law):
    never = plant([[-1, 0], [0, 0]], ZERO, [[0, 0], [0, "0.5"]], [[1, 0]], law)
    found = unseen(never)
    assert found.period is None and found.direction[0] == 0
    assert unseen(plant([[-1, 0], [0, "-0.5"]], ZERO, [[0, 0], [0, "0.4"]], [[1, 0]], law)) is None
    # It decays at no slope of the class but the upper end.
    assert unseen(plant([[-1, 0], [0, "-0.5"]], ZERO, [[0, 0], [0, "0.5"]], [[1, 0]], law)).values == (Exact("0.5"),)
    # The rate of a pendulum is measured: at slope 0 its angle never shows.
    angle = unseen(plant([[0, 1], [0, 0]], [[0, 0], ["-0.3", 0]], [[0, 0], ["0.3", 0]], [[0, 1]], law))
    assert angle.values == (Exact(0),) and [float(x) for x in angle.direction] == [1, 0]
    assert (
        unseen(plant([[0, 1], [0, 0]], [[0, 0], ["0.1", 0]], [[0, 0], ["0.3", 0]], [[0, 1]], periodic("0.3"))) is None
    )
    spiral = unseen(plant([[1, 2], [-2, 1]], ZERO, ZERO, [[0, 0]], law))
    assert spiral.period is None


def test_a_sum_of_equal_modes_hides_their_difference():
    made = plant([["pi", 0], [0, "pi"]], ZERO, ZERO, [["sqrt(2)", "sqrt(2)"]], periodic("0.5"))
    found = unseen(made)
    assert [float(x) for x in found.direction] == [1, -1] or [float(x) for x in found.direction] == [-1, 1]
    assert "x0 - x1" in found.sentence(made) or "x1 - x0" in found.sentence(made) or "-x0 + x1" in found.sentence(made)
    apart = plant([["pi", 0], [0, "2*pi"]], ZERO, ZERO, [["sqrt(2)", "sqrt(2)"]], periodic("0.5"))
    assert unseen(apart) is None


@pytest.mark.parametrize("K", [[["1"], ["1"]], [["0.3"], ["-0.4"]], [["0"], ["0"]]])
def test_the_direction_is_replayed_under_any_gain(K):
    made = oscillator(periodic("pi"))
    witness = unseen(made).witness(made)
    for loop in (impulsive(made, K), held(made, K)):
        run = replay(loop, witness)
        assert run.multiplier == pytest.approx(1, abs=1e-9)
        assert np.linalg.norm(run.e[-1]) == pytest.approx(1, abs=1e-6)
        assert len(run.t_k) > 6
    growing = oscillator(periodic("pi"), [["0.1", 1], [-1, "0.1"]])
    witness = unseen(growing).witness(growing)
    assert 1.3 < float(witness.multiplier) < math.exp(math.pi / 10)
    assert replay(impulsive(growing, K), witness).multiplier == pytest.approx(math.exp(math.pi / 10))


def test_a_direction_of_another_plant_is_refused():
    from cdobs_cli.errors import UsageError

    made = oscillator(periodic("pi"))
    witness = unseen(made).witness(made)
    loop = impulsive(made, [["1"], ["1"]])
    for direction in (["0", "0"], ["1"] * 5, ["x", "1"], [["1"], "0"]):
        with pytest.raises(UsageError):
            replay(loop, replace(witness, data={**witness.data, "direction": direction}))
