"""The proof of a stored certificate: an independent (13), simulated V, and what makes `proved` go."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from designing import designed
from reachability_asking import found, longest_of
from reachability_brute import histories, inequality_13, radius
from reachability_plants import PRINTED, chain, feedforward, plant, symmetric_chain

from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.families.reachability.certificate import constants
from cdobs_cli.families.reachability.sets import matrix_set
from cdobs_cli.families.reachability.theorems import lmi_13
from cdobs_cli.sampling import SamplingLaw

CASES = [
    (Reachability(), symmetric_chain((1, 0), "0.6")),
    (Reachability(set=PRINTED), symmetric_chain((1, 0), "0.6")),
    (Reachability(), symmetric_chain((1, "0.5"), "0.4")),
    (Reachability(), chain((-2, 0), (1, 1), "0.4")),
    (Reachability(), symmetric_chain((1, 0, 0), "0.7")),
    (Reachability(), chain((0, -1, 0), (2, 0, "0.5"), "0.4")),
    (Reachability(), feedforward("0.5")),
    (Reachability(), chain((-1, 0, 0), (1, 0, 0), "0.8", C=[[1, 0, 0], [0, 1, 1]])),
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_V_shrinks_along_every_history_and_spectral_radii_agree(case):
    p = case[1]
    design = found(case)
    assert design.proof.holds
    rho_squared = float(design.proof.rho_squared)
    P = design.P
    J = np.eye(p.n) - design.K.floats @ p.C.floats
    s = P - (J.T @ P @ J)  # P grows with s only where C e is not 0, so V is judged after a jump
    assert np.all(np.isfinite(s))
    Phi = histories(p, float(p.sampling.T_max), 200)
    rng = np.random.default_rng(0)
    for _ in range(3):
        e = J @ rng.normal(size=p.n)
        after = (J @ Phi @ e).T
        V, W = e @ P @ e, np.einsum("ik,ij,jk->k", after, P, after)
        assert np.all(rho_squared * V * (1 + 1e-9) >= W)
    assert max(radius(J @ F) for F in Phi) ** 2 <= rho_squared * (1 + 1e-9)


@pytest.mark.parametrize("case", CASES[:6], ids=str)
def test_13_holds_at_every_corner_of_the_box_written_out(case):
    family, p = case
    design = found(case)
    P = design.P
    W = P @ design.K.floats
    (box,) = matrix_set(family, p, p.sampling.T_max)
    center, spread = box.floats
    worst = np.inf
    for signs in product((-1, 1), repeat=p.n**2):
        M = center + np.reshape(signs, (p.n, p.n)) * spread
        big = inequality_13(P, W, M, p.C.floats)
        assert lmi_13(P, W, M, p.C.floats) == pytest.approx(big, abs=1e-12)
        worst = min(worst, np.linalg.eigvalsh(big)[0])
    assert worst > 0


def test_kappa_and_eta_are_the_papers_constants():
    p, design = CASES[0][1], found(CASES[0])
    paper = constants(design.question, design.certificate)
    P = design.P
    J = np.eye(2) - design.K.floats @ p.C.floats
    ch, sh, c, s = np.cosh(0.6), np.sinh(0.6), np.cos(0.6), np.sin(0.6)
    kappas = []
    for a, b, d, e in product((c, ch), (s, sh), (-s, sh), (c, ch)):
        N = J @ np.array([[a, b], [d, e]])
        kappas.append(np.linalg.eigvalsh(P - N.T @ P @ N)[0] / np.linalg.eigvalsh(P)[-1])
    eta = max(np.linalg.eigvalsh(P @ R + R.T @ P)[-1] for R in (np.array([[0, 1], [v, 0]]) for v in (-1, 1)))
    assert 0 < float(paper.kappa) <= min(kappas)
    assert float(paper.kappa) == pytest.approx(min(kappas), rel=1e-2)
    assert float(paper.eta) >= eta / np.linalg.eigvalsh(P)[0]
    assert float(paper.eta) == pytest.approx(eta / np.linalg.eigvalsh(P)[0], rel=1e-2)


def test_a_flipped_digit_of_the_gain_loses_proved():
    longest = longest_of(CASES[0])
    assert longest.proof.holds
    text = longest.K[1, 0]
    for k, digit in enumerate(str(text)):
        if digit.isdigit() and k < 6:
            flipped = str(text)[:k] + str((int(digit) + 5) % 10) + str(text)[k + 1 :]
            assert not longest.holds_for(ExactMatrix([["1"], [flipped]]))
    assert not longest.holds_for(ExactMatrix([["0.999"], [text]]))


def test_a_shrunk_lyapunov_matrix_loses_proved():
    design = found(CASES[4])
    Q = ExactMatrix(design.certificate.Q)
    for i, j, factor in ((0, 0, "0.2"), (1, 1, "0.2"), (0, 1, "2")):
        rows = [list(row) for row in Q.rows]
        rows[i][j] = rows[i][j] * Exact(factor)
        assert not design.holds_with(Q=ExactMatrix(rows).texts())


@pytest.mark.parametrize(
    "data",
    [
        {"rho_squared": "0.9"},
        {"rho_squared": "1"},
        {"rho_squared": "2"},
        {"rho_squared": "-1"},
        {"rho_squared": "pi"},
        {"rho_squared": None},
        {"Q": []},
        {"Q": [["-1"]]},
        {"Q": [["0"]]},
        {"Q": [["1", "0"], ["0", "1"]]},
        {"Q": [["__import__('os')"]]},
        {"form": "full"},
        {"form": "other"},
    ],
)
def test_a_damaged_certificate_is_never_proved(data):
    longest = longest_of(CASES[1])
    assert longest.holds_with() and not longest.holds_with(**data)


def test_the_proof_depends_on_the_period_of_the_certificate():
    design = found(CASES[0])
    later = replace(design.certificate, law=SamplingLaw.periodic(Exact("1.3")))
    assert not later.prove(design.question).holds
    beyond = replace(design.certificate, law=SamplingLaw.periodic(Exact("1.6")), rho_squared="0.999")
    assert not beyond.prove(design.question).in_time


def test_a_gain_with_C_K_not_one_needs_the_full_inequality():
    p = CASES[0][1]
    design = found(CASES[0], [["0.95"], ["1.6"]])
    assert design.certificate.form == "full"
    assert design.proof.holds
    assert design.proof.members == 8
    P = ExactMatrix(design.certificate.P).floats
    J = np.eye(2) - design.K.floats @ p.C.floats
    for Phi in histories(p, 0.6, 300):
        N = J @ Phi
        assert np.linalg.eigvalsh(P - N.T @ P @ N)[0] > 0


def test_all_states_measured_is_dead_beat_at_any_period():
    p = plant([[0, 1], [3, 0]], [[-1, -1], [-1, -1]], [[1, 1], [1, 1]], [[1, 1], [0, 2]], 50)
    design = found((Reachability(), p))
    assert design.K.texts() == [["1", "-0.5"], ["0", "0.5"]]
    assert design.proof.holds


def test_a_repeated_output_changes_nothing():
    twice = chain((-1, 0), (1, 0), "0.6", C=[[1, 0], [2, 0]])
    once = found(CASES[0])
    design = found((Reachability(), twice))
    assert design.proof.holds
    assert [row[0] for row in design.K.rows] == [row[0] for row in once.K.rows]
    assert all(row[1] == Exact(0) for row in design.K.rows)


def test_time_scaling_gives_the_same_design():
    slow, fast = CASES[4], (Reachability(), symmetric_chain(("1e9", 0, 0), "0.0007"))
    one, two = found(slow), found(fast)
    assert one.K.floats[:, 0] == pytest.approx(two.K.floats[:, 0] / 1000.0 ** np.arange(3), rel=1e-3)
    assert float(one.proof.rho_squared) == pytest.approx(float(two.proof.rho_squared), rel=1e-3)


def test_a_stored_design_is_proved_again():
    family, p = Reachability(), symmetric_chain((1, 0), "0.6")
    design = designed(family, p, 0)
    again = Design.from_document(json.loads(json.dumps(design.document())))
    assert family.certify(p, again, 0).verdict == "proved"
    flipped = replace(again, gain={"K": ExactMatrix([["1"], ["4.6739"]])})
    check = family.certify(p, flipped, 0)
    assert check.verdict != "proved"
    assert check.bounds["period_max"].proved is None
