"""Theorem 1 as printed, its repair, the Wirtinger forms, and periods that no gain survives."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from flint import fmpq
from lpv_asking import asked, of_every_gain
from lpv_plants import PRINTED_L, PRINTED_P, PRINTED_VERTICES, PRINTED_Y, linear_class, scalar, sine, two_outputs, up_to

from cdobs_cli.certify.methods.any_gain import NoGain
from cdobs_cli.certify.methods.wirtinger.certificate import Wirtinger
from cdobs_cli.certify.methods.wirtinger.design import HeldSynthesis
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh import printed, theorems
from cdobs_cli.families.lpv_zoh.repaired import Repaired
from cdobs_cli.families.lpv_zoh.structure import is_class_16
from cdobs_cli.hybrid import HybridInclusion, PlantView
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw


def exponential(M: np.ndarray) -> np.ndarray:
    scipy_linalg = pytest.importorskip("scipy.linalg")
    return np.asarray(scipy_linalg.expm(M))


def sampled_error(A_i: np.ndarray, L: np.ndarray, C: np.ndarray, T: float) -> np.ndarray:
    """e(t_k) -> e(t_(k+1)), from edot = A_i e - L C e(t_k) directly."""
    n = len(A_i)
    flow = exponential(np.block([[A_i, -L @ C], [np.zeros((n, 2 * n))]]) * T)
    return flow[:n, :n] + flow[:n, n:]


def radius(M: np.ndarray) -> float:
    return float(np.abs(np.linalg.eigvals(M)).max())


def the_printed(vertices: str) -> printed.Printed:
    view = PlantView.balls(sine(), {"L": PRINTED_L})
    corners = theorems.vertices_25(view) if vertices == "true" else [matrix.balls() for matrix in PRINTED_VERTICES]
    data = printed.Printed.of(PRINTED_P, PRINTED_Y, PRINTED_L, view.C, corners)
    assert data is not None
    return data


def test_printed_gain_is_the_quotient_only_to_its_digits():
    L = PRINTED_P.balls().solve(PRINTED_Y.balls()).floats
    assert L.ravel() == pytest.approx([8.71870, 7.05704], abs=5e-6)
    # L is printed as 8.7188, 7.0571: the quotient of the printed P, Y is further away than half a printed unit.
    assert abs(L[0, 0] - 8.7188) > 5e-5
    assert abs(L[1, 0] - 7.0571) > 5e-5


@pytest.mark.parametrize(("vertices", "mu", "tau_max"), [("true", 0.424158, 0.01145), ("printed", 0.308785, 0.00999)])
def test_printed_conditions_of_the_example(vertices, mu, tau_max):
    data = the_printed(vertices)
    numbers = printed.evaluate(data, fmpq(1, 10))
    assert float(numbers.mu_at_1.low) == pytest.approx(mu, abs=5e-7)
    assert float(numbers.beta.low) == pytest.approx(1.480978, abs=5e-7)
    if vertices == "true":
        assert float(numbers.alpha_1.high) == pytest.approx(0.019336, abs=5e-7)
        assert math.sqrt(float(numbers.T_1_squared.high)) == pytest.approx(0.0132, abs=5e-5)
    found = {claim.id: claim.status for claim in printed.claims(data, Exact("0.1"), "theorem_1", "at the vertices")}
    assert found == {
        "theorem_1.P": "proved", "theorem_1.lmi_26": "proved", "theorem_1.side_conditions": "refuted",
        "theorem_1.T_1": "refuted", "theorem_1.T_2": "proved",
    }  # fmt: skip
    bound = printed.tau_max_bound(data)
    assert float(bound.proved) == pytest.approx(tau_max, abs=5e-6)
    assert 0 < float(bound.refuted) - float(bound.proved) < 2e-6 * float(bound.refuted)


def test_printed_conditions_hold_and_their_twin_does_not():
    data = the_printed("true")
    assert printed.side_conditions(data, fmpq(1145, 100000)) == "proved"
    assert printed.side_conditions(data, fmpq(1146, 100000)) == "refuted"


def test_side_conditions_refuted_for_every_delta_by_brute_force():
    data = the_printed("true")
    P, Y, C = data.P.floats, data.Y.floats, data.C.floats
    low, high = np.linalg.eigvalsh(P)[[0, -1]]
    for tau in (0.0116, 0.05, 0.1):
        beta = 2 * tau**2 * high * 8.7188**2
        for delta in np.geomspace(1.0001, 100, 60):
            worst = max(
                np.linalg.eigvalsh(
                    P @ A_i + A_i.T @ P - Y @ C - C.T @ Y.T + Y @ Y.T + np.diag([0, 2 * tau**2 * delta])
                )[-1]
                for A_i in (np.array([[0, 1], [psi, 0]]) for psi in (-0.3, 0.3))
            )
            assert not beta < min(-worst * low, 2 * tau * (delta - 1))


def test_wirtinger_with_the_printed_gain_ends_at_its_cap():
    cap = math.pi / (2 * 8.7188)
    assert cap == pytest.approx(0.180162, abs=5e-7)
    certificate = Wirtinger.propose(asked(sine(), PRINTED_L, "0.1801"))
    assert certificate is not None
    assert certificate.prove(asked(sine(), PRINTED_L)).holds
    assert Wirtinger.propose(asked(sine(), PRINTED_L, "0.1802")) is None


def test_a_stored_certificate_dies_with_one_digit():
    question = asked(sine(), PRINTED_L)
    certificate = Wirtinger.propose(question.at(Exact("0.18")))
    assert certificate is not None
    assert not certificate.prove(asked(sine(), ExactMatrix([["8.9188"], ["7.0571"]]))).holds
    shrunk = [[str(float(v) / 2) for v in row] for row in certificate.P]
    for change in ({"P": shrunk}, {"law": up_to("0.19")}, {"sigma": "0.2"}):
        assert not replace(certificate, **change).prove(question).holds


def largest_rate(plant: Plant, L: ExactMatrix, tau: str) -> float:
    low, high = Fraction(0), Fraction(2)
    for _ in range(16):
        middle = (low + high) / 2
        low, high = (middle, high) if Wirtinger.propose(asked(plant, L, tau, middle)) else (low, middle)
    return float(low)


def test_the_rate_of_the_scalar_loop_is_not_overclaimed():
    # edot = -e(t_k), tau = 1.5: e(t_k+1) = -e(t_k) / 2, so the rate is ln 2 / 1.5 = 0.4621. Adding 2 sigma P
    # alone, without sigma in G, would certify 0.5115.
    plant, L = scalar("1.5"), ExactMatrix([["1"]])
    naive, above = 0.3, 0.7
    while above - naive > 1e-5:
        middle = (naive + above) / 2
        naive, above = (middle, above) if naive_rate_holds(middle) else (naive, middle)
    assert naive == pytest.approx(0.5115, abs=2e-4)
    proved = largest_rate(plant, L, "1.5")
    assert 0.02 < proved < math.log(2) / 1.5 < naive


def naive_rate_holds(sigma: float) -> bool:
    q = (2 * 1.5 / math.pi) ** 2
    G = np.array([[-1.0, 1.0]])
    return any(
        np.linalg.eigvalsh(np.array([[-2 + 2 * sigma, 1.0], [1.0, -U]]) + q * U * G.T @ G)[-1] < 0
        for U in np.linspace(0.2, 20, 1000)
    )


@pytest.mark.parametrize("sigma", ["0", "0.3"])
def test_wirtinger_rate_covers_the_sampled_error(sigma):
    L, C = PRINTED_L.floats, np.array([[1.0, 0.0]])
    assert Wirtinger.propose(asked(sine(), PRINTED_L, "0.12", sigma)) is not None
    for T in np.linspace(0.01, 0.12, 8):
        for psi in np.linspace(-0.3, 0.3, 5):
            rho = radius(sampled_error(np.array([[0, 1], [psi, 0]]), L, C, T))
            assert rho < math.exp(-float(sigma) * T)


def test_wirtinger_synthesis_reaches_134_with_a_rate():
    found = HeldSynthesis(sine()).design(1.34, 0.0015)
    L = ExactMatrix.from_floats(found.L, 5)
    assert L.floats.ravel() == pytest.approx([1.17, 0.34], abs=0.01)
    assert Wirtinger.propose(asked(sine(), L, "1.34", "0.001")) is not None
    assert HeldSynthesis(sine()).design(1.36, 0.0).margin <= 0


def test_what_the_synthesis_finds_the_analysis_proves():
    for plant, tau in ((sine(), 0.9), (two_outputs(), 0.4)):
        found = HeldSynthesis(plant).design(tau, 0.05)
        assert found.margin > 0
        assert Wirtinger.propose(asked(plant, ExactMatrix.from_floats(found.L, 8), str(tau), "0.05")) is not None


@pytest.mark.parametrize("scale", [1e-6, 1e3, 1e6])
def test_time_scaling(scale):
    # x(t) at another speed: A -> s A, slopes -> s slopes, L -> s L, tau -> tau / s.
    s = Fraction(scale)
    plant = linear_class(
        [["0", str(s)], ["0", "0"]], [["1", "0"]], {(1, 0): (str(-s * 3 / 10), str(s * 3 / 10))}, up_to("1")
    )
    L = ExactMatrix([[Exact(s * Fraction("8.7188"))], [Exact(s * Fraction("7.0571"))]])
    assert Wirtinger.propose(asked(plant, L, Exact(Fraction("0.1801") / s))) is not None
    assert Wirtinger.propose(asked(plant, L, Exact(Fraction("0.1802") / s))) is None


def test_state_and_output_scaling():
    plant = linear_class([["0", "1e-5"], ["0", "0"]], [["1e6", "0"]], {(1, 0): ("-0.3e5", "0.3e5")}, up_to("1"))
    L = ExactMatrix([["8.7188e-6"], ["7.0571e-1"]])
    assert Wirtinger.propose(asked(plant, L, "0.1801")) is not None
    assert Wirtinger.propose(asked(plant, L, "0.1802")) is None


def test_undetectable_plants_are_never_designed_for():
    blind = linear_class([["0", "0"], ["0", "0.1"]], [["1", "0"]], {}, up_to("0.1"))
    found = HeldSynthesis(blind).design(0.1, 0.0)
    L = ExactMatrix.from_floats(np.nan_to_num(found.L), 6)
    assert Wirtinger.propose(asked(blind, L, "0.1")) is None


def test_repaired_condition_and_its_twin():
    question = asked(sine(), PRINTED_L)
    certificate = Repaired.propose(question.at(Exact("0.03")))
    assert certificate is not None
    proof = certificate.prove(question)
    assert proof.holds
    rate = float(proof.rate)
    assert rate > 0.2
    for T in (0.01, 0.03):
        for psi in (-0.3, 0.0, 0.3):
            rho = radius(sampled_error(np.array([[0, 1], [psi, 0]]), PRINTED_L.floats, np.array([[1.0, 0.0]]), T))
            assert rho < math.exp(-rate * T)
    assert not replace(certificate, law=up_to("0.06")).prove(question).holds
    assert Repaired.propose(question.at(Exact("0.1"))) is None


def test_repaired_is_for_its_class_only():
    assert is_class_16(sine())
    assert not is_class_16(two_outputs())
    assert not is_class_16(scalar("1"))
    assert Repaired.propose(asked(two_outputs(), ExactMatrix([[1, 0]] * 4), "0.1")) is None


def test_repaired_time_scaling():
    # The class (16) is kept by t -> s t with x_i in powers of s: compare an analysis in other units.
    slow = linear_class([["0", "1"], ["0", "0"]], [["1", "0"]], {(1, 0): ("-0.003", "0.003")}, up_to("1"))
    L = ExactMatrix([["0.87188"], ["0.070571"]])
    assert Repaired.propose(asked(slow, L, "0.3")) is not None
    assert Repaired.propose(asked(slow, L, "1")) is None


def test_no_gain_survives_a_quarter_turn():
    end = math.pi / (2 * math.sqrt(0.3))
    assert end == pytest.approx(2.867869, abs=5e-7)
    for law in (up_to("2.8679"), SamplingLaw.periodic(Exact("2.8679"))):
        certificate = NoGain.propose(of_every_gain(sine(law)))
        assert certificate is not None
        assert certificate.prove(of_every_gain(sine())).holds
        assert not replace(certificate, law=up_to("2.8")).prove(of_every_gain(sine())).holds
    assert NoGain.propose(of_every_gain(sine(up_to("2.8678")))) is None


def test_constant_periods_beyond_need_slopes_inside_the_box():
    # The corners leave gains where |cot(omega T / 2)| > 1, past three quarter turns (T = 8.6036); psi between does not.
    for T in np.linspace(2.9, 10.0, 13):
        certificate = NoGain.propose(of_every_gain(sine(SamplingLaw.periodic(Exact(f"{T:.3f}")))))
        assert certificate is not None
        inside = any(face["slopes"] not in (["-0.3"], ["0.3"]) for face in certificate.faces)
        assert inside or T < 8.61


def test_faces_of_another_class_prove_nothing():
    certificate = NoGain.propose(of_every_gain(sine(up_to("2.9"))))
    assert certificate is not None
    narrower = linear_class([["0", "1"], ["0", "0"]], [["1", "0"]], {(1, 0): ("-0.2", "0.2")}, up_to("2.9"))
    assert not certificate.prove(of_every_gain(narrower)).holds


def test_vertices_are_only_those_of_entries_that_vary():
    assert len(theorems.vertices_25(PlantView.floats(sine(), {}))) == 2
    assert len(theorems.vertices_25(PlantView.floats(two_outputs(), {}))) == 4


def test_error_maps_are_the_sampled_error():
    for plant, L in (
        (sine(), PRINTED_L),
        (two_outputs(), ExactMatrix([[1, "0.1"], ["0.3", 0], ["0.2", 1], [0, "0.4"]])),
    ):
        inclusion = HybridInclusion(theorems.error_maps, plant, {"L": L}, plant.sampling, plant.slopes.quantities)
        maps, n = inclusion.floats, plant.n
        for flow, A_i in zip(maps.corners(), theorems.vertices_25(PlantView.floats(plant, {})), strict=True):
            monodromy = maps.jump @ exponential(flow * 0.37)
            assert monodromy[:n, :n] == pytest.approx(sampled_error(A_i, L.floats, plant.C.floats, 0.37), abs=1e-10)
            assert np.abs(monodromy[n:]).max() == 0
        exact = inclusion.balls
        assert exact.base.floats == pytest.approx(maps.base)
        assert exact.jump.floats == pytest.approx(maps.jump)
