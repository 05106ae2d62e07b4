"""Counterexamples as certificates: what is stored is proved again, for the question that it is about and no other."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from example_inclusions import canonical, impulsive, periodic
from noisy_examples import pendulum

from cdobs_cli.certify.ascent import highest
from cdobs_cli.certify.floats import exponentials
from cdobs_cli.certify.methods.base import Question, read
from cdobs_cli.certify.methods.counterexample import Attained, Counterexample
from cdobs_cli.certify.switching import _cycle
from cdobs_cli.exact.numbers import Exact


def held(c: list[Any], T: str, gain: list[list[str]]) -> Question:
    return Question(impulsive(canonical(c, periodic(T)), gain))


def test_a_counterexample_is_proved_again_and_of_its_own_gain_law_and_class_only() -> None:
    question = held([1, 0], "1.3", [["1"], ["1.8361"]])
    found = Counterexample.propose(question)
    assert found is not None and found.prove(question).holds
    stored = read(found.certificate(), (Counterexample,))
    assert stored is not None and stored.method == found
    assert not found.prove(held(["0.1", 0], "1.3", [["1"], ["1.8361"]])).holds, "slopes outside the class"
    assert not found.prove(held([1, 0], "1.3", [["1"], ["0.5"]])).holds, "a gain that survives"
    assert not replace(found, law=periodic("1.2")).prove(question).holds, "another law"
    for witness in ({}, {**found.witness, "times": []}, {**found.witness, "values": "x"}, {**found.witness, "more": 1}):
        assert not replace(found, witness=witness).prove(question).holds


@pytest.mark.parametrize("K_2", ["1.8361", "1.47478", "0.8839931"])
def test_the_shortest_refuted_period_is_where_a_fine_walk_finds_it(K_2: str) -> None:
    """Beside it: every period tried upwards by a hundredth, the first one refuted."""
    question = held([1, 0], "0.5", [["1"], [K_2]])
    found = Counterexample.shortest(question, Exact("0.5"))
    assert found is not None and found.prove(question).holds
    end = float(found.law.T_max)
    walk = (Exact(Fraction(k, 200)) for k in range(100, 500))
    first = next(T for T in walk if Counterexample.propose(question.at(T)) is not None)
    assert float(first) - 0.0051 < end < float(first) + 1e-9
    assert Counterexample.propose(question.at(Exact(f"{end * (1 - 1e-4):.9f}"))) is None


def test_an_attained_error_is_proved_again_from_below() -> None:
    question = pendulum("0.6", ("1", "1.47478"), effort=0)
    for i in range(2):
        found = Attained.propose(question.of_state(i))
        assert found is not None
        reached = found.prove(question).error
        assert reached is not None and reached > 0
        assert not replace(found, state=1 - i).prove(question).holds
        scaled = {**found.witness["data"], "v": [["1"] for _ in found.witness["data"]["v"]]}
        assert not replace(found, witness={**found.witness, "data": scaled}).prove(question).holds, "too much noise"


@pytest.mark.parametrize("seed", range(4))
def test_the_slopes_of_a_words_radius_are_those_of_differences(seed: int) -> None:
    """d|lambda| = Re p_end' dE e for the length of an arc, its flow and a jump, against central differences."""
    rng = np.random.default_rng(seed)
    flows, lengths = rng.normal(size=(5, 3, 3)), rng.uniform(0.1, 0.5, 5)
    jumps, ends, step = rng.normal(size=(2, 3, 3)), (1, 4), 1e-6

    def size(of_lengths: Any = 0.0, of_flow: Any = 0.0, of_jumps: Any = 0.0) -> float:
        E = exponentials((flows + of_flow) * (lengths + of_lengths)[:, None, None])
        M = np.eye(3)
        for s in range(5):
            M = E[s] @ M
            M = (jumps + of_jumps)[ends.index(s)] @ M if s in ends else M
        return float(np.abs(np.linalg.eigvals(M)).max())

    def difference(**change: Any) -> float:
        up, down = ({name: sign * step * one for name, one in change.items()} for sign in (1, -1))
        return (size(**up) - size(**down)) / (2 * step)

    cycle = _cycle(exponentials(flows * lengths[:, None, None]), jumps, ends)
    assert cycle is not None and cycle.size == pytest.approx(size())
    for s in range(5):
        by_length = np.real(cycle.p_end[s] @ flows[s] @ cycle.e_end[s])
        assert by_length == pytest.approx(difference(of_lengths=np.eye(5)[s]), rel=1e-5, abs=1e-7)
    change = rng.normal(size=(2, 3, 3))
    by_jumps = sum(np.real(cycle.p_jump[w] @ change[w] @ cycle.e_end[end]) for w, end in enumerate(ends))
    assert by_jumps == pytest.approx(difference(of_jumps=change), rel=1e-5, abs=1e-7)


def test_a_climb_stays_in_its_room_and_finds_the_top() -> None:
    def hill(at: Any) -> tuple[float, Any]:
        x, y = at
        return -((x - 1) ** 2) - 10 * (y - x / 2) ** 2, np.array([-2 * (x - 1) + 10 * (y - x / 2), -20 * (y - x / 2)])

    best, at = highest(hill, np.array([[-3.0, 3.0], [-3.0, 3.0]]), 0.7)
    assert best == pytest.approx(0, abs=1e-9) and at == pytest.approx([1, 0.5], abs=1e-5)
    _, walled = highest(hill, np.array([[-0.5, 0.4], [-3.0, 3.0]]), 0.2)
    assert walled == pytest.approx([0.4, 0.2], abs=0.01)
