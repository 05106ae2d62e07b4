"""Counterexamples run again."""

import numpy as np
import pytest
from scipy.linalg import expm

from cdobs_cli.certificate import Witness
from cdobs_cli.errors import UsageError
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.hybrid import HybridInclusion, corrected_copy
from cdobs_cli.plant import Plant, Slopes
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.witness import replay


def inclusion(K, T="0.6"):
    """Error of observer (3) on the pendulum's class, |V21| <= 1."""
    slopes = Slopes(ExactMatrix([[0, 0], [-1, 0]]), ExactMatrix([[0, 0], [1, 0]]))
    phi = (parse("0"), parse("sin(theta)", frozenset({"theta"})))
    plant = Plant(
        ("theta", "omega"),
        (),
        ExactMatrix([[0, 1], [0, 0]]),
        phi,
        None,
        ExactMatrix([[1, 0]]),
        slopes,
        SamplingLaw.periodic(Exact(T)),
    )

    return HybridInclusion(
        corrected_copy, plant, {"K": ExactMatrix([[k] for k in K])}, plant.sampling, plant.slopes.quantities
    )


PRINTED = ("-1", "-1.8361")


def test_the_printed_gain_of_dinh2014_grows_by_its_spectral_radius():
    witness = Witness("constant", "class", ("0.668",), (("1",),), "4.6", ((1, 0),), {"arcs": [1]})
    run = replay(inclusion(PRINTED), witness)
    A = np.array([[0, 1], [1, 0.0]])
    J = np.eye(2) - np.array([[-1], [-1.8361]]) @ [[1, 0]]
    radius = max(abs(np.linalg.eigvals(J @ expm(0.668 * A))))
    assert radius == pytest.approx(4.6, abs=0.05)
    assert run.multiplier == pytest.approx(radius, rel=1e-9)
    assert np.diff(run.t_k) == pytest.approx(0.668)
    assert len(run.t) == len(run.e) == len(run.V)
    assert set(run.V[:, 0]) == {1.0}
    jumps = np.flatnonzero(np.diff(run.t) == 0)
    assert len(jumps) == len(run.t_k) - 1
    assert run.e[jumps + 1] == pytest.approx(run.e[jumps] @ J.T)
    sizes = np.linalg.norm(run.e, axis=1)
    assert sizes[-1] > 100 * sizes[0]
    assert run.document()["multiplier_proved"] == "4.6"


def test_switching_arcs_and_words_of_several_periods():
    """Two periods of 0.4 and 0.6, the second switching; a complex pair has a measured multiplier too."""
    times, values = ("0.4", "0.25", "0.35"), (("-1",), ("1",), ("-1",))
    witness = Witness("switching", "class", times, values, None, ((1, 0),), {"arcs": [1, 2]})
    run = replay(inclusion(PRINTED), witness)

    def phi(v, s):
        return expm(s * np.array([[0, 1], [v, 0.0]]))

    J = np.eye(2) - np.array([[-1], [-1.8361]]) @ [[1, 0]]
    M = J @ phi(-1, 0.35) @ phi(1, 0.25) @ J @ phi(-1, 0.4)
    assert run.multiplier == pytest.approx(max(abs(np.linalg.eigvals(M))), rel=1e-9)
    assert np.diff(run.t_k)[:4] == pytest.approx([0.4, 0.6, 0.4, 0.6])
    assert set(run.V[:, 0]) == {-1.0, 1.0}
    assert set(run.arrays()) == {"t", "e", "V", "t_k", "entries"}


def test_a_complex_pair():
    witness = Witness("constant", "class", ("0.6",), (("-1",),), None, ((1, 0),), {"arcs": [1]})
    run = replay(inclusion(("0", "-0.5")), witness)
    M = (np.eye(2) - np.array([[0], [-0.5]]) @ [[1, 0]]) @ expm(0.6 * np.array([[0, 1], [-1, 0.0]]))
    values = np.linalg.eigvals(M)
    assert abs(values[0].imag) > 0.1
    assert run.multiplier == pytest.approx(max(abs(values)), rel=1e-9)


def test_what_cannot_be_run_is_refused():
    with pytest.raises(UsageError, match="kind point"):
        replay(inclusion(PRINTED), Witness("point", "plant"))
    with pytest.raises(UsageError, match="other slopes"):
        replay(inclusion(PRINTED), Witness("constant", "class", ("0.6",), (("1",),), None, ((0, 0),), {"arcs": [1]}))
    with pytest.raises(UsageError, match="cannot be read"):
        replay(inclusion(PRINTED), Witness("constant", "class", ("0.6",), (("1",),), None, ((1, 0),), {}))
