"""Errors that are gone after finitely many samples, and their neighbours that are not."""

from fractions import Fraction

import pytest
from asking import analyse, analyse_by, longest, proof, proves
from example_inclusions import aperiodic, canonical, held, impulsive, periodic, plant
from flint import arb

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.methods.dead_beat import DeadBeat
from cdobs_cli.certify.methods.spectral import SpectralRadius
from cdobs_cli.exact.numbers import Exact, lower_text, upper_text

UNSTABLE = ([[0, 1], [5, 3]], [[0, 0], [-1, 0]], [[0, 0], [1, 0]])
IDENTITY = [[1, 0], [0, 1]]


def reset(K, law=None):
    return impulsive(plant(*UNSTABLE, IDENTITY, law or aperiodic(0, 5)), K)


@pytest.mark.parametrize("law", [aperiodic(0, 5), aperiodic("0.1", "1e6"), periodic("pi"), periodic("1e-9")])
def test_a_sample_that_tells_the_state_erases_every_error(law):
    certificate = analyse(reset(IDENTITY, law), 0, Fraction(10**6))
    assert certificate.method == DeadBeat.name
    shown = proof(reset(IDENTITY, law), Certificate.from_document(certificate.document()))
    assert shown.holds and shown.rate == arb("inf")
    assert longest(lambda _: reset(IDENTITY, law), str(law.T_max), 1)[0] == law.T_max


@pytest.mark.parametrize(
    "K",
    [
        [[1, 0], [0, "0.999999"]],
        [["1", "1e-30"], [0, 1]],
        [["1 + (pi+1e-60) - pi", 0], [0, 1]],
        [[1, "1e-400"], [0, 1]],
    ],
)
def test_what_is_nearly_erased_is_not(K):
    assert analyse_by(DeadBeat, reset(K)) is None
    assert not proves(reset(K), Certificate(DeadBeat.name, aperiodic(0, 5), {}))


def test_outputs_that_are_mixed_or_repeated():
    mixed = plant(*UNSTABLE, [[2, 1], [1, 1], [0, 1]], aperiodic(0, 5))
    assert analyse_by(DeadBeat, impulsive(mixed, [[1, -1, 0], [-1, 2, 0]])) is not None
    assert analyse_by(DeadBeat, impulsive(mixed, [[1, -1, 0], [-1, 1, 0]])) is None


def test_a_double_integrator_is_brought_to_rest_in_two_samples():
    """e+ = (I - K C) exp(A T) e with K = (1, 1/T) is nilpotent; in balls its radius is only below every sigma tried."""
    for T, rate in (("0.5", "2"), ("3", "1/3"), ("1e-3", "1000")):
        loop = impulsive(canonical([0, 0], periodic(T)), [["1"], [rate]])
        certificate = analyse(loop, 0)
        assert certificate.method == DeadBeat.name
        assert proves(loop, certificate)
        for law in (periodic("0.7"), aperiodic(0, T), periodic("pi")):
            assert not proves(loop, Certificate(DeadBeat.name, law, {}))
    nearly = impulsive(canonical([0, 0], periodic("0.5")), [["1"], ["2.000001"]])
    assert analyse(nearly, 0).method == SpectralRadius.name
    # An uncertain slope, a flow that is not nilpotent.
    assert analyse_by(DeadBeat, impulsive(canonical(["0.001", 0], periodic("0.5")), [["1"], ["2"]])) is None
    decaying = plant([[0, 1], [0, -1]], [[0, 0]] * 2, [[0, 0]] * 2, [[1, 0]], periodic("0.5"))
    assert analyse_by(DeadBeat, impulsive(decaying, [["1"], ["2"]])) is None


def test_a_held_integrator_is_brought_to_rest():
    """edot = -L e(t_k), L T = 1."""
    made = plant([[0]], [[0]], [[0]], [[1]], periodic("0.5"))
    assert analyse(held(made, [["2"]]), 0).method == DeadBeat.name
    assert analyse(held(made, [["1.9"]]), 0).method == SpectralRadius.name


def test_a_series_that_does_not_end_is_not_cut_off():
    """1 + F T = 0 for edot = -e at T = 1: the first terms alone would erase the error."""
    assert (
        analyse(impulsive(plant([[-1]], [[0]], [[0]], [[1]], periodic(1)), [["0.5"]]), 0).method == SpectralRadius.name
    )


def test_no_law_no_certificate():
    for law in (periodic("0"), aperiodic("-1", "1")):
        assert not proves(reset(IDENTITY), Certificate(DeadBeat.name, law, {}))


def test_infinite_rates_are_printed_as_such():
    assert lower_text(arb("inf")) == upper_text(arb("inf")) == "inf"
    assert lower_text(-arb("inf")) == upper_text(-arb("inf")) == "-inf"
    assert (lower_text(arb("nan")), upper_text(arb("nan"))) == ("-inf", "inf")
    assert (lower_text(arb(0, "inf")), upper_text(arb(0, "inf"))) == ("-inf", "inf")
    assert lower_text(Exact("1/3").ball(), 3) == "0.333"
