import json
import math
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from asking import analyse, design, longest, proves
from example_inclusions import aperiodic, canonical, held, impulsive, periodic, plant

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.falsify import refute
from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.certificate import GAIN_DIGITS, Clock, serves, shapes
from cdobs_cli.certify.methods.clock.design import ImpulsiveGain
from cdobs_cli.certify.methods.clock.slope import slope
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text


def open_loop(c, sampling):
    return impulsive(canonical(c, sampling), [["0"]] * len(c))


def boukal(law, L=(("1.166",), ("0.332",))):
    made = plant([[0, 1], [0, 0]], [[0, 0], ["-0.3", 0]], [[0, 0], ["0.3", 0]], [[1, 0]], law)
    return held(made, L)


@pytest.mark.parametrize(
    ("c", "T"),
    [([1, 0], "1.63"), ([1, 1, 1], "0.62"), ([1, 0, 0], "1.54"), ([1, 0, 0, 0], "1.46"), ([1] + [0] * 7, "1.1")],
)
def test_designs_for_canonical_plants(c, T):
    """Periods the theory note gives for the clock certificate (its paper's own box: 1.211 for the pendulum)."""
    K, certificate = design(open_loop(c, periodic(T)), 2 if len(c) == 4 else 1)
    assert ExactMatrix.from_floats(K.floats, GAIN_DIGITS) == K
    closed = impulsive(canonical(c, periodic(T)), K.texts())
    assert proves(closed, Certificate.from_document(certificate.document()))
    assert refute(closed, 0) is None


def test_a_certificate_speaks_for_its_own_gain_law_and_slopes_only():
    K, certificate = design(open_loop([1, 0], periodic("1.6")), 1)

    def proved(c=(1, 0), gain=K.floats, change=None, law=None):
        document = certificate.document()
        document["data"] = {**document["data"], **(change or {})}
        if law is not None:
            document["sampling"] = law.document()
        closed = impulsive(canonical(list(c), periodic("1.6")), ExactMatrix.from_floats(gain, 6).texts())
        return proves(closed, Certificate.from_document(document))

    assert proved()
    assert not proved(gain=K.floats * 1.3)
    assert not proved(gain=-K.floats)
    assert not proved(c=(2, 0))
    assert proved(c=("0.9", 0))  # a smaller class
    assert not proved(law=periodic("2.5"))
    assert not proved(law=aperiodic("0.8", "1.6"))
    P = certificate.data["P"]
    shrunk = [[[str(Exact(value) * Exact("0.5")) for value in row] for row in P[0]], *P[1:]]
    for change in (
        {"P": shrunk}, {"P": P[:-1]}, {"P": P[::-1]}, {"sigma": "1"}, {"sigma": "-1"}, {"degree": "0"},
        {"pieces": ["0", "4"]}, {"pieces": ["4"]}, {"basis": [["1", "0"], ["0", "0"]]}, {"P": "nothing"},
    ):  # fmt: skip
        assert not proved(change=change), change


def test_held_innovation_from_zero_between_and_at_one_period():
    """A set of periods that grows proves less, never more; the certificate from T_min = 0 covers them all."""
    from_zero = analyse(boukal(aperiodic(0, "1.45")), 1)
    between = analyse(boukal(aperiodic("0.3", "1.55")), 1)
    alone = analyse(boukal(periodic("1.59")), 1)
    assert from_zero is not None and between is not None and alone is not None
    assert analyse(boukal(aperiodic("0.3", "1.45")), 1) is not None
    assert analyse(boukal(periodic("1.45")), 1) is not None
    assert analyse(boukal(periodic("1.61")), 2) is None


def test_decay_rate_of_a_scalar_held_loop_is_ln2_over_tau():
    """edot = -e(t_k), period 3/2: e(t_(k+1)) = -e(t_k)/2 exactly; no rate above ln 2 / 1.5 = 0.46210 may be proved."""
    scalar = plant([[0]], [[0]], [[0]], [[1]], periodic("1.5"))
    inclusion = held(scalar, [["1"]])
    assert analyse(inclusion, 1, Fraction("0.4620")) is not None
    assert analyse(inclusion, 1, Fraction("0.4622")) is None
    # The same through the quadratic function, with a slope that is uncertain by a hair.
    nearly = held(plant([[0]], [["-0.0001"]], [["0.0001"]], [[1]], periodic("1.5")), [["1"]])
    certificate = analyse(nearly, 1, Fraction("0.455"))
    assert certificate is not None and certificate.method == Clock.name
    assert analyse(nearly, 2, Fraction("0.4622")) is None


def test_linear_loops_are_decided_by_their_spectral_radius():
    """Oscillator with e+ = (I - K C) e, K = (1, 6/5): rho = |cos T - 1.2 sin T|, lost and regained with T."""
    zero = [[0, 0], [0, 0]]
    for T in np.arange(0.1, 8.0, 0.13):
        text = decimal_text(float(T), 4)
        inclusion = impulsive(plant([[0, 1], [-1, 0]], zero, zero, [[1, 0]], periodic(text)), [["1"], ["1.2"]])
        rho = abs(math.cos(float(text)) - 1.2 * math.sin(float(text)))
        assert (analyse(inclusion, 0) is not None) == (rho < 1)
        assert (refute(inclusion, 0) is not None) == (rho >= 1)


@pytest.mark.parametrize("effort", [0, 3])
def test_what_is_not_detectable_is_never_proved(effort):
    zero = [[0, 0], [0, 0]]
    undetectable = plant([[-1, 0], [0, 0]], zero, [[0, 0], [0, "0.5"]], [[1, 0]], periodic("0.3"))
    assert design(impulsive(undetectable, [["0"], ["0"]]), effort) is None
    assert analyse(held(undetectable, [["1"], ["1"]]), effort) is None
    # An oscillator sampled at its half period shows one point of its circle.
    pathological = plant([[0, 1], [-1, 0]], zero, zero, [[1, 0]], periodic("pi"))
    assert design(impulsive(pathological, [["0"], ["0"]]), effort) is None
    assert analyse(impulsive(pathological, [["1"], ["1"]]), effort) is None


def random_inclusion(rng, law):
    n = int(rng.integers(1, 4))
    p = int(rng.integers(1, n + 1))
    text = np.vectorize(lambda value: decimal_text(float(value), 3))
    A = text(rng.standard_normal((n, n)))
    radius = np.where(rng.random((n, n)) < 0.3, rng.random((n, n)), 0.0)
    centre = radius * rng.uniform(-1, 1, (n, n))
    C = text(rng.standard_normal((p, n)))
    made = plant(A.tolist(), text(centre - radius).tolist(), text(centre + radius).tolist(), C.tolist(), law)
    return n, p, made


def test_no_random_plant_is_both_proved_and_refuted():
    """Hundreds of plants, gains and laws; every proof is also held against constant slopes inside the box."""
    rng = np.random.default_rng(6)
    proofs = refutations = 0
    for trial in range(240):
        T = decimal_text(float(10 ** rng.uniform(-1.5, 0.5)), 3)
        low = decimal_text(float(T) * 0.4, 3)
        law = [periodic(T), aperiodic(low, T), aperiodic(0, T)][trial % 3]
        n, p, made = random_inclusion(rng, law)
        C = np.array(made.C.floats)
        gain = np.linalg.pinv(C) + 0.2 * rng.standard_normal((n, p))
        if trial % 2 and law.T_min.sign():
            designed = design(impulsive(made, np.zeros((n, p)).tolist()), 0)
            gain = gain if designed is None else designed[0].floats
            inclusion = impulsive(made, ExactMatrix.from_floats(gain, 6).texts())
        else:
            inclusion = held(made, ExactMatrix.from_floats(gain * (1 + trial % 4), 6).texts())
        proved = analyse(inclusion, 0) is not None
        refuted = refute(inclusion, 0) is not None
        assert not (proved and refuted)
        proofs, refutations = proofs + proved, refutations + refuted
        if proved:
            maps = inclusion.floats
            v = rng.uniform(size=(30, len(maps.lower))) * (np.array(maps.upper) - maps.lower) + maps.lower
            lowest = float(law.T_min) or float(T) * 0.01
            periods = rng.uniform(lowest, float(T), 30)
            flows = np.array([maps.flow(tuple(row)) * t for row, t in zip(v, periods, strict=True)])
            assert spectral_radii(maps.jump @ exponentials(flows)).max() < 1
    assert proofs > 50 and refutations > 50


def test_monotone_in_the_slopes_and_the_same_in_other_units():
    def period(c, unit=1.0, states=(1.0, 1.0)):
        """The largest period, in the first units, of the pendulum typed in others: t' = t / unit, x' = x / states."""
        s = states[1] / states[0]
        chain = [[0, decimal_text(s * unit, 12)], [0, 0]]
        bound = decimal_text(c / s * unit, 12)

        def at(T):
            made = plant(
                chain, [[0, 0], ["-" + bound, 0]], [[0, 0], [bound, 0]], [[decimal_text(states[0], 12), 0]], periodic(T)
            )
            return impulsive(made, [["0"], ["0"]])

        return float(ImpulsiveGain().longest(Question(at(decimal_text(0.5 / unit, 6)))).law.T_max) * unit

    first = period(1.0)
    assert first >= 1.625
    assert period(1.2) < first < period(0.8)
    assert period(1.0, unit=1e-3) == pytest.approx(first, rel=5e-3)
    assert period(1.0, unit=1e4) == pytest.approx(first, rel=5e-3)
    assert period(1.0, states=(1e3, 1e-3)) == pytest.approx(first, rel=5e-3)


def test_period_search_for_a_given_gain():
    T, certificate = longest(lambda T: boukal(aperiodic(0, T)), "0.5", 1)
    assert 1.45 < float(T) < 1.55
    assert proves(boukal(certificate.sampling), certificate)
    assert longest(lambda T: boukal(aperiodic(0, T), (("-1",), ("0",))), "0.5", 1) is None


@pytest.mark.parametrize(("T", "expected"), [("0.9", True), ("1.45", True), ("1.7", False), ("3", False)])
def test_whether_a_shape_serves_is_the_sign_of_its_largest_margin(T, expected):
    question = Question(boukal(aperiodic(0, T)), effort=1)
    shape = list(shapes(question))[-1]
    met = slope(question.afresh(), shape)
    assert serves(question.afresh(), shape) == expected == (met is not None and met.margin > 0)


def test_a_proof_loads_no_solver():
    certificate = analyse(boukal(periodic("1.2")), 0)
    code = (
        "import json, sys; sys.path.insert(0, sys.argv[2]); import test_clock as t;"
        "from cdobs_cli.certificate import Certificate;"
        "c = Certificate.from_document(json.loads(sys.argv[1])); i = t.boukal(c.sampling);"
        "ok = t.proves(i, c) and t.refute(i, 1) is None;"
        "sys.exit(not ok or any(name in sys.modules for name in ('clarabel', 'cvxpy', 'scipy')))"
    )
    arguments = [json.dumps(certificate.document()), str(Path(__file__).parent)]
    assert subprocess.run([sys.executable, "-c", code, *arguments], check=False).returncode == 0


def test_impulsive_jumps_from_period_zero():
    """With C K = I the jump is a projection: laws [0, T] are proved, for any gain that keeps it exactly."""
    law = aperiodic(0, "1.5")
    K, certificate = design(open_loop([1, 0], law), 1)
    closed = impulsive(canonical([1, 0], law), K.texts())
    assert K[0, 0] == Exact(1)
    assert proves(closed, Certificate.from_document(certificate.document()))
    assert refute(closed, 2) is None
    # C K = 0.999 keeps 0.001 of the measured error: proved in a basis of its own, not by the projection's certificate.
    nearly = impulsive(canonical([1, 0], law), [["0.999"], [str(K[1, 0])]])
    assert proves(nearly, analyse(nearly, 1))
    assert not proves(nearly, certificate)
    # A projection that is not diagonal: C = [1, 2], C K = I.
    slanted = plant(
        [[0, 1], ["-0.5", "-0.2"]], [[0, 0], ["-0.1", 0]], [[0, 0], ["0.1", 0]], [[1, 2]], aperiodic(0, "0.4")
    )
    certificate = analyse(impulsive(slanted, [["0.2"], ["0.4"]]), 1)
    assert certificate is not None
    assert proves(impulsive(slanted, [["0.2"], ["0.4"]]), certificate)
    assert not proves(impulsive(slanted, [["0.2"], ["0.41"]]), certificate)
    # Every period of an interval from 0 is in it: a proof for [0, T] is one for each constant period.
    assert analyse(impulsive(canonical([1, 0], periodic("1.1")), K.texts()), 1) is not None


def test_the_pendulum_from_period_zero_is_proved_further_than_1_59():
    """Of its constant periods the exact limit is 1.713, and 1.633 where P is of the degree of the first shapes."""
    law = aperiodic(0, "1.59")
    question = Question(impulsive(canonical([1, 0], law), [[0], [0]]), effort=1)
    met = ImpulsiveGain().at(question)
    assert met is not None and met.law == law
    assert met.method.prove(question.with_gain({"K": met.gain})).holds


def test_from_zero_what_is_kept_is_not_coupled_with_what_is_lost():
    """P(0) - J'P(0)J has a zero block there: any coupling makes it indefinite at tau = 0, however small."""
    law = aperiodic(0, "0.4")
    for K in ("0.6", "1"):
        closed = impulsive(canonical([1, 0], law), [[K], ["0.7"]])
        certificate = analyse(closed, 0)
        (a, _), (c,) = certificate.data["P"][0]
        coupled = [[[a, "1e-9"], [c]], *certificate.data["P"][1:]]
        assert proves(closed, certificate)
        assert not proves(closed, Certificate(Clock.name, law, {**certificate.data, "P": coupled}))


def test_a_function_that_is_negative_on_what_the_jump_enlarges_is_none():
    """e_2+ = 2 e_2, e_2dot = e_2 and P_22 = -1 meet flow and jump inequalities; e_1 is kept and decays."""
    law = aperiodic("0.5", "1")
    loop = impulsive(plant([[-1, 0], [0, 1]], [[0, 0]] * 2, [[0, 0]] * 2, [[0, 1]], law), [["0"], ["-1"]])
    P = [[[a, "0"], ["-1"]] for a in ("1", "1.25", "1.5")]
    data = {
        "degree": "1",
        "elevated": "1",
        "pieces": ["1", "1"],
        "sigma": "0",
        "basis": [["1", "0"], ["0", "1"]],
        "P": P,
    }
    assert not proves(loop, Certificate(Clock.name, law, data))
    stable = impulsive(plant([[-1, 0], [0, -1]], [[0, 0]] * 2, [[0, 0]] * 2, [[0, 1]], law), [["0"], ["1"]])
    data["P"] = [[[a, "0"], ["1"]] for a in ("1", "1.25", "1.5")]
    assert proves(stable, Certificate(Clock.name, law, data))
