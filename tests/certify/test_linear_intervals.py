"""Linear loops under an interval of periods: forms and polygons of the sampled error, words of mixed periods."""

import json
import math
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from asking import analyse, analyse_by, longest, proves
from example_inclusions import aperiodic, held, impulsive, plant
from flint import arb
from linear_loops import ZERO, largest_product, loops

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import taylor
from cdobs_cli.certify.bracket import smallest_refuted
from cdobs_cli.certify.falsify import refute
from cdobs_cli.certify.methods.common_quadratic import CommonQuadratic
from cdobs_cli.certify.methods.polygon import Polygon, _sides
from cdobs_cli.certify.sampled_error import full_rank_factors, kept_and_lost
from cdobs_cli.certify.symmetric_power import monomials, power
from cdobs_cli.certify.words import refutes
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact


def scalar(T, K="0.5"):
    """e+ = (1 - K) e^s e."""
    return impulsive(plant([[1]], [[0]], [[0]], [[1]], aperiodic(0, T)), [[K]])


def two_held(T):
    made = plant([["-2", 0], [0, "-0.9"]], ZERO, ZERO, [[1, 0], [0, 1]], aperiodic(0, T))
    return held(made, [["1", "0"], ["1", "1"]])


def test_a_scalar_loop_is_proved_up_to_ln_2():
    T, certificate = longest(scalar, "0.2", 3)
    assert math.log(2) * (1 - 1e-4) < float(T) < math.log(2)
    assert proves(scalar(str(T)), Certificate.from_document(certificate.document()))
    assert analyse(scalar("0.69315"), 3) is None
    assert refute(scalar("0.69315"), 0) is not None
    # C K beyond (0, 2) leaves the measured error larger than it was.
    for K in ("0", "-0.1", "2", "2.5"):
        assert analyse(scalar("0.01", K), 1) is None


def test_two_held_outputs_come_close_to_what_is_refuted():
    T, certificate = longest(two_held, "1", 1)
    lost, witness = smallest_refuted(lambda T: two_held(str(T)), T, 1)
    assert 3.26 < float(T) < float(lost) < 3.275
    assert refutes(two_held(str(lost)), witness)
    assert not proves(two_held(str(lost)), replace(certificate, sampling=aperiodic(0, str(lost))))


def thin(T, low="0.1"):
    """A planar error that forms of low degree do not prove to the end."""
    made = plant([["-3.06", "0.794"], ["-0.617", "1.49"]], ZERO, ZERO, [["-0.65", "-1.18"]], aperiodic(low, T))
    return impulsive(made, [["1.55"], ["-1.08"]])


def thin_from_zero(T):
    """The same from T_min = 0: the jump keeps one direction and turns the other over."""
    made = plant([["-0.0305", "-1.21"], ["-0.295", "-0.108"]], ZERO, ZERO, [["-0.143", "0.827"]], aperiodic(0, T))
    return impulsive(made, [["0.384"], ["1.77"]])


def test_polygons_prove_what_forms_of_low_degree_do_not():
    for loop, T, beyond in ((thin, "0.277", "0.28"), (thin_from_zero, "0.62", "0.723")):
        assert analyse_by(CommonQuadratic, loop(T), 1) is None
        certificate = analyse(loop(T), 1)
        assert certificate.method == Polygon.name
        assert proves(loop(T), certificate)
        assert largest_product(loop(T), np.random.default_rng(2)) < 1
        assert analyse_by(Polygon, loop(beyond), 1) is None
        assert refute(loop(beyond), 1) is not None


@pytest.mark.parametrize(("kind", "at"), loops(9, seed=3), ids=lambda value: value if isinstance(value, str) else "")
def test_brackets_of_random_loops_are_narrow(kind, at):
    """Up to 1.50 apart, or with no proof at all from T_min = 0, by the clock-dependent function alone."""
    T, certificate = longest(at, "0.2", 1)
    lost, _ = smallest_refuted(at, T, 0)
    assert 1 < float(lost) / float(T) < 1.1
    assert proves(at(T), Certificate.from_document(json.loads(json.dumps(certificate.document()))))
    assert largest_product(at(T), np.random.default_rng(1)) < 1


def test_no_random_loop_is_both_proved_and_refuted():
    rng = np.random.default_rng(8)
    proofs = refutations = 0
    for number, (_, at) in enumerate(loops(102, seed=20)):
        inclusion = at(round(0.15 + 0.9 * float(rng.random()) ** 2, 3))
        proved = analyse(inclusion, number % 2)
        witness = refute(inclusion, number % 2)
        assert proved is None or witness is None
        if proved is not None:
            assert largest_product(inclusion, rng, 60, 20) < 1
        if witness is not None:
            assert refutes(inclusion, witness)
            assert all(
                inclusion.sampling.T_min.rational <= Fraction(t) <= inclusion.sampling.T_max.rational
                for t in witness.times
            )
        proofs, refutations = proofs + (proved is not None), refutations + (witness is not None)
    assert proofs > 40 and refutations > 10


def certificates():
    """One of each method and kind of law, with its loop."""
    made = [(two_held("2.5"), None), (scalar("0.5"), None)]
    made += [(at("0.25"), None) for _, at in loops(3, seed=3)]
    made += [(loop, analyse_by(Polygon, loop, 1)) for loop in (thin("0.25"), thin_from_zero("0.55"))]
    return [(inclusion, certificate or analyse_by(CommonQuadratic, inclusion, 1)) for inclusion, certificate in made]


def test_a_certificate_speaks_for_its_own_loop_law_and_rate_only():
    for inclusion, certificate in certificates():
        assert proves(inclusion, certificate)

        def proved(certificate=certificate, inclusion=inclusion, law=None, **data):
            changed = replace(certificate, sampling=law or certificate.sampling, data={**certificate.data, **data})
            return proves(inclusion, changed)

        law = inclusion.sampling
        assert not proved(law=replace(law, T_max=Exact("100")))
        assert not proved(sigma="1e999999999") and not proved(
            P=[["1e999999999"]], vertices=[["1e999999999", "0"], ["0", "1"]]
        )
        assert not proved(sigma="30") and not proved(sigma="-1") and not proved(sigma="x")
        assert not proved(law=replace(law, T_min=Exact("-1")))
        if certificate.method == CommonQuadratic.name:
            P = certificate.data["P"]
            assert not proved(P=[[f"-{v}" if not v.startswith("-") else v[1:] for v in row] for row in P])
            assert not proved(P=[["0" for _ in row] for row in P])
            assert not proved(degree="0") and not proved(degree="99") and not proved(P=P[:-1]) and not proved(P=[])
        else:
            half = certificate.data["vertices"]
            assert not proved(vertices=half[::-1]) and not proved(vertices=half[:1]) and not proved(vertices=[])
            assert not proved(vertices=[*half, ["0", "0"]])
            # A corner pulled out of the polygon is mapped outside of what is left.
            for k in range(len(half)):
                pulled = [
                    [str(Fraction(x) * 3), str(Fraction(y) * 3)] if i == k else [x, y] for i, (x, y) in enumerate(half)
                ]
                assert not proved(vertices=pulled)
    # The kept error must not be coupled with the rest from T_min = 0.
    inclusion, certificate = certificates()[4]
    assert inclusion.sampling.T_min.sign() == 0 and len(certificate.data["P"]) == 2
    (a, _), (c,) = certificate.data["P"]
    assert not proves(inclusion, replace(certificate, data={**certificate.data, "P": [[a, "0.0001"], [c]]}))


def form(loop, P, degree="1", sigma="0"):
    return proves(loop, Certificate(CommonQuadratic.name, loop.sampling, {"sigma": sigma, "degree": degree, "P": P}))


def corners(loop, vertices=(("1", "-1"), ("1", "1")), sigma="0"):
    data = {"sigma": sigma, "vertices": [list(vertex) for vertex in vertices]}
    return proves(loop, Certificate(Polygon.name, loop.sampling, data))


def turned(K, law, rate="0"):
    """e+ = (1 - K) exp(rate s) e in the plane."""
    return impulsive(plant([[rate, 0], [0, rate]], ZERO, ZERO, [[1, 0], [0, 1]], law), [[K, 0], [0, K]])


def test_a_form_that_is_negative_grows_where_it_seems_to_fall():
    assert form(scalar("0.5"), [["1"]])
    assert not form(scalar("0.5", "-1"), [["-1"]])
    assert not form(scalar("0.5", "-1"), [["1"]])


def test_no_period_of_the_law_is_left_out():
    """M(s) = exp(A s)_11 = 1 + 0.01 s - 0.5 s^2 + ..: the error grows at periods below 0.02 only."""

    def grows_at_first(low):
        return impulsive(plant([["0.01", 1], [-1, 0]], ZERO, ZERO, [[0, 1]], aperiodic(low, 1)), [["0"], ["1"]])

    assert refute(grows_at_first("0"), 1) is not None
    assert not form(grows_at_first("0"), [["1"]])
    assert not form(grows_at_first("0.001"), [["1"]])
    assert form(grows_at_first("0.03"), [["1"]])


def test_slopes_that_vary_are_not_left_out():
    law = aperiodic("0.1", "0.3")

    def loop(up):
        return impulsive(
            plant([[1, 0], [0, 1]], ZERO, [[up, 0], [0, 0]], [[1, 0], [0, 1]], law), [["0.5", 0], [0, "0.5"]]
        )

    assert form(loop("0"), [["1", "0"], ["1"]]) and corners(loop("0"))
    assert not form(loop("9"), [["1", "0"], ["1"]]) and not corners(loop("9"))


def test_polygons_are_judged_at_all_corners_sides_and_periods():
    law = aperiodic("0.1", "0.2")
    assert corners(turned("1.9", law)) and corners(turned("1.995", law)) and corners(turned("0.005", law))
    for K in ("2.005", "2.5", "-0.005"):
        assert not corners(turned(K, law))
    # A corner that leaves across the opposite side only.
    across = impulsive(plant(ZERO, ZERO, ZERO, [[1, 0], [0, 1]], law), [["1.75", "-0.75"], ["-0.1", "0.9"]])
    assert not corners(across)
    # The error grows before it decays: 1.05 exp(-20 s), below 1 from s = 0.0025 on.
    assert corners(turned("-0.05", aperiodic("0.0025", "0.06"), "-20"))
    assert not corners(turned("-0.05", aperiodic("0.0024", "0.06"), "-20"))
    assert not corners(turned("-0.05", aperiodic(0, "0.06"), "-20"))
    assert corners(turned("0.5", aperiodic("0.1", "0.2"), "-1"), sigma="4") and not corners(
        turned("0.5", aperiodic("0.1", "0.2"), "1"), sigma="4"
    )


@pytest.mark.parametrize(
    "vertices",
    [
        [(1, -1), (1, 1)][::-1],
        [(1, -1), ("0.1", 0), (1, 1)],  # not convex
        [(1, 0), (1, 0)], [(1, 0), (-1, 0)], [(0, 0), (1, 1)],
        [(4, 0), (-2, 3), (-2, -3), (4, "0.1")],  # more than one turn
        [(10, 0), ("-3.09", "9.51"), ("-8.09", "-5.87"), ("8.09", "-5.87"), ("3.09", "9.51")],
    ],
)  # fmt: skip
def test_what_is_no_convex_polygon_round_zero(vertices):
    half = [(Fraction(x), Fraction(y)) for x, y in vertices]
    assert _sides(half) is None
    assert _sides([(Fraction(1), Fraction(-1)), (Fraction(1), Fraction(1))]) == [(1, 0), (0, 1)]


@pytest.mark.parametrize("size", [Fraction(1, 2), Fraction(13, 10), Fraction(19, 10), 50])
def test_taylor_polynomials_hold_what_they_leave_out(size):
    F = Matrix.from_rows([[0, 1], [-1, Fraction(-1, 3)]])
    one = Matrix.identity(2)
    span = size / Fraction(float(np.linalg.norm(F.floats)))
    made = taylor.exponential(one, F, one, Fraction(1, 7), Fraction(1, 7) + span)
    if size == 50:
        assert made is None
        return
    for u in (Fraction(0), Fraction(1, 3), Fraction(1)):
        value = F.exp(Fraction(1, 7) + span * u)
        squared = taylor.entries(made)
        for i in range(2):
            for j in range(2):
                total = sum((matrix[i, j] * fraction_ball(u) ** k for k, matrix in enumerate(made)), arb(0))
                assert total.overlaps(value[i, j]) and total.contains(value[i, j].mid())
                product = squared[i][0] * squared[0][j]
                powers = tuple(fraction_ball(u) ** k for k in range(taylor.ORDER + 1))
                assert product.combination(powers).contains((value[i, 0] * value[0, j]).mid())


def test_rates_are_those_of_the_slowest_word():
    """edot = -e(t_k): e(t_k + s) = (1 - s) e, T_k <= 3/2; |1 - s| <= exp(-sigma s) up to ln 2 / 1.5 = 0.4621."""
    loop = held(plant([[0]], [[0]], [[0]], [[1]], aperiodic(0, "1.5")), [["1"]])
    assert analyse(loop, 1, Fraction("0.4620")) is not None
    assert analyse(loop, 1, Fraction("0.4622")) is None
    # Forms of degree 2 d decay at 2 d sigma: the error's rate is sigma, whatever d.
    for degree in (1, 2, 3):
        for sigma, holds in (("0.4620", True), ("0.4622", False)):
            assert form(loop, [["1"]], str(degree), sigma) is holds


def test_the_sampled_error_is_the_jump_on_its_range():
    J = Matrix.from_rows([[1, 0, 2], [0, 0, 0], [0, 0, Fraction(1, 2)]])
    X, Y = full_rank_factors(J)
    assert (X @ Y).data == J.data and X.shape == (3, 2)
    kept, S = kept_and_lost(J)
    assert kept == 1
    assert (S.inverse() @ J @ S)[0:1, :].data == Matrix.from_rows([[1, 0, 0]]).data
    assert kept_and_lost(Matrix.from_rows([[1, 1], [0, 1]])) is None  # 1 is not semisimple
    assert full_rank_factors(Matrix.zeros(2, 2))[0].shape == (2, 0)


@pytest.mark.parametrize("d", [1, 2, 3])
def test_monomials_of_a_mapped_vector(d):
    rng = np.random.default_rng(d)
    M, z = rng.standard_normal((3, 3)), rng.standard_normal(3)
    for first in (0, 1, 2):
        names = monomials(3, d, first)
        inside = [max(name) < first for name in names]
        assert inside == sorted(inside, reverse=True)

        def raised(v, names=names):
            return np.array([np.prod([v[i] for i in name]) for name in names])

        assert np.allclose(np.array(power(M.tolist(), d, first)) @ raised(z), raised(M @ z))


def test_proofs_of_intervals_load_no_solver():
    inclusion, certificate = two_held("2.5"), analyse(two_held("2.5"), 1)
    assert certificate.method == CommonQuadratic.name
    code = (
        "import json, sys; sys.path.insert(0, sys.argv[2]); import test_linear_intervals as t;"
        "c = t.Certificate.from_document(json.loads(sys.argv[1]));"
        "ok = t.proves(t.two_held('2.5'), c) and t.refute(t.two_held('3.4'), 1) is not None;"
        "sys.exit(not ok or any(name in sys.modules for name in ('clarabel', 'cvxpy', 'scipy')))"
    )
    arguments = [json.dumps(certificate.document()), str(Path(__file__).parent)]
    assert subprocess.run([sys.executable, "-c", code, *arguments], check=False).returncode == 0
    assert proves(inclusion, certificate)
