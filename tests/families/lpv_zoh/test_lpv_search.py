"""The searches: cutting planes over corners, units, the climb over gains. What they return is a guess."""

from __future__ import annotations

import numpy as np
import pytest
from lpv_asking import asked
from lpv_plants import linear_class, sine, two_outputs, up_to

from cdobs_cli.certify import cuts
from cdobs_cli.certify.climb import Climb
from cdobs_cli.certify.lmi import symmetric
from cdobs_cli.certify.methods.wirtinger.certificate import Wirtinger, inequality
from cdobs_cli.certify.methods.wirtinger.design import HeldSynthesis
from cdobs_cli.certify.units import Units
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.hybrid import PlantView


def test_cutting_planes_find_what_all_corners_find(monkeypatch):
    random = np.random.default_rng(5)
    vertices = [np.array([[-1.0, 0.3], [-0.2, -1.0]]) + 0.4 * np.diag(random.uniform(-1, 1, 2)) for _ in range(60)]

    def margin() -> float:
        return cuts.largest_margin(
            {"P": symmetric(2)},
            lambda x, A: -x["P"] @ A - A.T @ x["P"],
            vertices,
            (lambda x: x["P"],),
            lambda x: np.trace(x["P"]) - 1,
        )[1]

    some = margin()
    monkeypatch.setattr(cuts, "_FIRST", 60)
    assert some == pytest.approx(margin(), rel=1e-4)


def test_units_leave_the_claims_alone():
    plant = two_outputs()
    L = ExactMatrix([[1, "0.1"], ["0.3", 0], ["0.2", 1], [0, "0.4"]])
    given = PlantView.floats(plant, {"L": L})
    units = Units.of(given, 0.4)
    view = units.view(given)
    assert units.gain_out(view.gain["L"]) == pytest.approx(L.floats)
    random = np.random.default_rng(2)
    raw, U = random.normal(size=(4, 4)), np.diag([2.0, 3.0])
    P = raw @ raw.T + np.eye(4)
    A, A_s = given.vertices[1], view.vertices[1]
    q, sigma, tau, eye = (2 / np.pi) ** 2, 0.3, 0.4, np.eye(2)
    scaled = inequality(P, U, A_s - view.gain["L"] @ view.C, view.gain["L"], view.C, q, sigma * tau, eye)
    plain = inequality(
        units.states_out(P), units.outputs_out(U), A - L.floats @ given.C, L.floats, given.C, q * tau**2, sigma, eye
    )
    change = np.concatenate([units.states, units.outputs])
    assert tau * plain * change * change[:, None] == pytest.approx(scaled)


def test_units_of_a_chain():
    chain = linear_class([["0", "2", "0"], ["0", "0", "5"], ["0", "0", "0"]], [["4", "0", "0"]], {}, up_to("0.1"))
    given = PlantView.floats(chain, {})
    units = Units.of(given, 0.1, slower=1.0)
    assert pytest.approx(np.eye(3, k=1)) == units.view(given).A
    assert pytest.approx(np.eye(1, 3)) == units.view(given).C


def test_the_climb_ends_near_the_top_and_keeps_what_was_proved():
    top = np.array([[2.0], [0.5]])
    asked = []

    def passes(L: ExactMatrix, value: float) -> bool:
        asked.append((L, value))
        return value <= 1 - float(np.sum((L.floats - top) ** 2))

    L, value = Climb(passes, np.ones((2, 1)), 300).run(np.array([[1.6], [0.8]]), 0.5)
    assert value > 0.98
    assert passes(L, value)
    assert len(asked) <= 301
    few, reached = Climb(passes, np.ones((2, 1)), 300, goal=0.9).run(np.array([[1.6], [0.8]]), 0.5)
    assert reached == 0.9 and passes(few, 0.9)


def test_the_fastest_rate_falls_with_the_period():
    rates = [HeldSynthesis(sine()).fastest(T)[0] for T in (0.3, 0.6, 1.2)]
    assert rates == sorted(rates, reverse=True) and rates[-1] > 0
    assert HeldSynthesis(sine()).fastest(1.5)[1].margin <= 0
    L = ExactMatrix.from_floats(HeldSynthesis(sine()).fastest(0.6)[1].L, 6)
    assert Wirtinger.propose(asked(sine(), L, "0.6")) is not None
