"""What must not pass for a proof: rates below 0, balls that only seem to be 0, data that says nothing."""

from fractions import Fraction

import pytest
from asking import analyse, proves
from example_inclusions import aperiodic, canonical, impulsive, periodic, plant

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.methods.clock.form import erases_the_rest, kept_states
from cdobs_cli.certify.methods.planar import every_gain
from cdobs_cli.certify.methods.planar.extremals import Planar, cleared_gain, planar_class
from cdobs_cli.certify.methods.spectral import SpectralRadius
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact

ZERO = [[0, 0], [0, 0]]


@pytest.mark.parametrize("data", [{"sigma": "-5"}, {}, {"sigma": "x"}, {"sigma": "pi"}])
def test_a_spectral_radius_proves_no_growth_rate(data):
    """edot = e, e+ = 0.9 e grows: a rate of -5 would be met, and is no decay."""
    growing = impulsive(plant([[1]], [[0]], [[0]], [[1]], periodic(1)), [["0.1"]])
    assert not proves(growing, Certificate(SpectralRadius.name, growing.sampling, data))


@pytest.mark.parametrize("data", [{}, {"sigma": "-5"}, {"sigma": None}])
def test_planar_certificates_without_a_rate_prove_nothing(data):
    closed = impulsive(canonical(["1", "0"], periodic("0.5")), [["1"], ["0.7"]])
    assert proves(closed, Certificate(Planar.name, closed.sampling, {"sigma": "0"}))
    assert not proves(closed, Certificate(Planar.name, closed.sampling, data))


def test_what_balls_cannot_tell_from_zero_is_not_zero():
    small = (Exact("pi") - Exact("pi+1e-60")).ball()
    assert small.contains(0) and not small.is_zero()
    assert kept_states(Matrix.from_rows([[1, 0], [0, 0]])) == [0]
    assert kept_states(Matrix.from_rows([[1, small], [0, 0]])) == []
    nearly_erased = Matrix.from_rows([[1, 0], [0, small]])
    assert kept_states(nearly_erased) == [0]
    assert not erases_the_rest(nearly_erased, [0])
    assert erases_the_rest(Matrix.from_rows([[1, 0], [0, 0]]), [0])
    exactly = impulsive(canonical(["1", "0"], periodic("0.5")), [["1"], ["0.7"]])
    assert cleared_gain(exactly) is not None
    nearly = impulsive(canonical(["1", "0"], periodic("0.5")), [["1 + (pi+1e-60) - pi"], ["0.7"]])
    assert nearly.balls.jump[0, 0].contains(0)
    assert cleared_gain(nearly) is None


def test_pathological_sampling_is_never_proved_and_is_refuted():
    """xddot = -pi^2 x sampled at its half periods: the output repeats up to sign, whatever the gain."""
    for T in ("1", "2"):
        oscillator = plant([[0, "pi"], ["-pi", 0]], ZERO, ZERO, [[1, 0]], periodic(T))
        for K in (["1", "0"], ["0.5", "0.3"], ["1", "1"]):
            closed = impulsive(oscillator, [[K[0]], [K[1]]])
            assert analyse(closed, 0) is None
    law = aperiodic("0.5", "1")
    assert analyse(impulsive(plant([[0, "pi"], ["-pi", 0]], ZERO, ZERO, [[0, 0]], law), [["0"], ["0"]]), 0) is None


def test_words_that_do_not_fill_the_period_refute_no_gain(monkeypatch):
    """Switching times are rounded: a V(t) that outlasts the period, or runs backwards, is none of the class."""
    family, _ = planar_class(impulsive(canonical(["1", "0"], periodic("1.7131")), [["0"], ["0"]]))
    delta, ends = Fraction("1.7131"), (1, 1)
    cells = every_gain._Cells(family, delta, 0)
    assert len(list(cells._extremals())) == 6
    for arcs in ([(delta + Fraction(1, 10**12), ends)], [(delta + 1, ends), (Fraction(-1), ends)]):
        monkeypatch.setattr(every_gain, "switching", lambda *_, arcs=arcs: arcs)
        assert len(list(cells._extremals())) == 4
