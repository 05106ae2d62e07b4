"""Sensors with periods and offsets of their own: the law, monodromy and certificates over a hyperperiod, its words."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import made
from example_inclusions import impulsive, plant
from schedules import filtered, is_met, radius, random_schedule, without_gain
from scipy.linalg import expm

from cdobs_cli.certificate import Witness
from cdobs_cli.certify import search
from cdobs_cli.certify.falsify import refute
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.certificate import Clock, design_impulsive
from cdobs_cli.certify.methods.clock.graph import ClockGraph
from cdobs_cli.certify.methods.clock.graph_design import GraphGain, design_graph
from cdobs_cli.certify.methods.common_quadratic import CommonQuadratic
from cdobs_cli.certify.methods.counterexample import Counterexample
from cdobs_cli.certify.methods.dead_beat import DeadBeat
from cdobs_cli.certify.methods.rung import GENERAL
from cdobs_cli.certify.unseen import unseen
from cdobs_cli.certify.words import Arc, Word, prove, refutes
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import Gains, Sensor, hyperperiod, is_bounded
from cdobs_cli.simulate.witness import replay

F = Fraction


def law(T: Any, *sensors: tuple[str, tuple[int, ...], Any, Any], gains: Gains = "by_phase") -> SamplingLaw:
    return SamplingLaw.multirate(
        Exact(T), [Sensor(name, outputs, F(every), F(offset)) for name, outputs, every, offset in sensors], gains
    )


def staggered(T: Any, gains: Gains = "by_phase") -> SamplingLaw:
    return law(T, ("a", (0,), 1, 0), ("b", (1,), 1, "1/2"), gains=gains)


def doubled(T: Any, gains: Gains = "by_phase") -> SamplingLaw:
    """theta1 every second time that theta2 is read."""
    return law(T, ("a", (0,), 2, 0), ("b", (1,), 1, 0), gains=gains)


# ---------------------------------------------------------------- the law


def test_what_the_law_holds() -> None:
    one = law("0.1", ("x", (0,), 1, 0), ("theta", (1, 2), 4, "1/2"))
    assert one.words == "x every 0.1, theta every 0.4 from 0.05 on"
    assert one.text("s") == "x every 0.1 s, theta every 0.4 s from 0.05 s on"
    assert [phase.name for phase in one.phases] == ["x", "theta", "x", "x", "x"]
    assert [str(gap) for gap in one.gaps] == ["0.05", "0.05", "0.1", "0.1", "0.1"]
    assert (str(one.hyperperiod), str(one.T_min), str(one.T_max), str(one.period)) == ("0.4", "0.05", "0.1", "0.1")
    assert one.gain_columns(3) == 6 and one.unread(3) == [[1, 2], [0], [1, 2], [1, 2], [1, 2]]
    assert one.with_period(Exact("0.2")).words == "x every 0.2, theta every 0.8 from 0.1 on"
    assert SamplingLaw.from_document(one.document()) == one
    # Equal gaps make no constant period, and no law of another kind is held.
    half = staggered("0.2")
    assert half.T_min == half.T_max and not half.is_periodic and not half.is_bounded and not half.multiples
    others = [SamplingLaw.periodic(Exact("0.1")), SamplingLaw("aperiodic", Exact("0.01"), Exact(1))]
    others += [SamplingLaw.periodic(Exact("0.1"), 3), half.with_period(Exact("0.1")), replace(half, gains="one")]
    assert half.contains(half) and not any(half.contains(other) or other.contains(half) for other in others)
    assert not half.allows(Exact("0.1"))


def test_sensors_that_are_always_read_together_are_one() -> None:
    assert law("0.2", ("a", (0,), 1, 0), ("b", (1,), 1, 0)) == SamplingLaw.periodic(Exact("0.2"))
    assert law("0.2", ("a", (0, 1), 1, 0)) == SamplingLaw.periodic(Exact("0.2"))


def test_the_hyperperiod_is_the_least_common_multiple() -> None:
    sensors = [Sensor("a", (0,), F(1)), Sensor("b", (1,), F(3, 2)), Sensor("c", (2,), F(5, 4))]
    assert hyperperiod(sensors) == 15 and is_bounded(sensors)
    assert not is_bounded([Sensor("a", (0,), F(1)), Sensor("b", (1,), F(10**12 + 1, 10**12))])


def entry(name: Any = "b", outputs: Any = (1,), every: Any = "2", offset: Any = "0", **more: Any) -> dict[str, Any]:
    return {"name": name, "outputs": list(outputs), "every": every, "offset": offset, **more}


FIRST = entry("a", (0,), "1")


@pytest.mark.parametrize("change", [
    {"sensors": []}, {"gains": "many"}, {"period": "0"}, {"period": "-1"}, {"more": 1},
    {"sensors": [FIRST]}, {"sensors": [entry("a", (-1,), "1")]}, {"sensors": FIRST}, {"sensors": [FIRST, []]},
    *({"sensors": [FIRST, entry(**other)]} for other in (
        {"name": "a"}, {"name": 2}, {"outputs": (0,)}, {"outputs": (2,)}, {"outputs": (True,)}, {"outputs": ()},
        {"every": "1/2"}, {"every": 2}, {"every": "1000001/1000000"}, {"offset": "2"}, {"offset": "-1"}, {"more": 1},
    )),
])  # fmt: skip
def test_what_is_no_such_law(change: dict[str, Any]) -> None:
    law = doubled("0.1").document()
    assert SamplingLaw.from_document(law | {"sensors": [FIRST, entry()]}).is_multirate
    with pytest.raises((ValueError, TypeError)):
        SamplingLaw.from_document(law | change)


# ---------------------------------------------------------------- linear plants

CART = """\
spec_version: 1
plant:
  states: [x, v, theta, omega]
  A: [[0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1], [0, 0, "10/3", 0]]
  phi: ["0", "0", "0", "0"]
  lipschitz: [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]
measurement:
  sensors:
    x: {C: [[1, 0, 0, 0]], period: 0.1}
    theta: {C: [[0, 0, 1, 0]], period: 0.4}
observer:
  family: reachability
simulation: {horizon: 20, initial_state: [1, 0, 0.1, 0], initial_estimate: [0, 0, 0, 0]}
"""
BY_SENSORS = "{x+theta: [[1, 0], [5, -.0816], [0, 1], [.0178, 2.7949]], x: [[1], [10], [-.1505], [-1.5079]]}"


def given(K: str) -> str:
    return CART.replace("  family: reachability\n", f"  family: reachability\n  gain: {{K: {K}}}\n")


def test_cart_and_pendulum_with_the_gain_of_the_theory(tmp_path: Path) -> None:
    """Source: theory, measurement schemes, (a): x every h, theta every 4 h, rho = 1 at h = 0.2139."""
    result = made(tmp_path, given(BY_SENSORS))
    assert result.status == "ok" and result.check is not None and result.simulation is not None
    bound = result.check["bounds"]["period_max"]
    assert 0.2130 <= float(bound["proved"]) < float(bound["refuted"]) <= 0.2150
    assert float(bound["proved"]) == pytest.approx(0.2139, abs=5e-5) == float(bound["refuted"])
    assert "x every T, theta every 4 T" in bound["about"] and "in proportion" in bound["about"]
    assert result.simulation["overall"]["error_final"] < 1e-9
    with np.load(tmp_path / "out" / "simulation.npz") as arrays:
        read = ~np.isnan(arrays["y_k"])
    assert read[:, 0].all() and read[::4, 1].all() and not read[1::4, 1].any() and not read[2::4, 1].any()


def test_a_gain_of_sensors_may_be_typed_in_three_ways(tmp_path: Path) -> None:
    both, alone = "[[1, 0], [5, -.0816], [0, 1], [.0178, 2.7949]]", "[[1], [10], [-.1505], [-1.5079]]"
    turned = "{x: " + alone + ", theta+x: [[0, 1], [-.0816, 5], [1, 0], [2.7949, .0178]]}"
    gains = []
    for K in (BY_SENSORS, f"[{both}, {alone}, {alone}, {alone}]", turned):
        result = made(tmp_path, given(K), ("check",))
        assert result.design is not None and result.status == "ok"
        gains.append(result.design["gain"]["K"])
    assert gains[0] == gains[1] == gains[2] and len(gains[0][0]) == 5
    columns = made(tmp_path, given("{x: [[1], [2], [0], [0]], theta: [[0], [0], [1], [2]]}"), ("check",)).design
    matrix = made(tmp_path, given("[[1, 0], [2, 0], [0, 1], [0, 2]]"), ("check",)).design
    assert columns is not None and matrix is not None and columns["gain"] == matrix["gain"]


def test_the_tool_reaches_further_than_the_given_gain(tmp_path: Path) -> None:
    text = CART.replace("  family: reachability\n", "  family: reachability\n  objective: max_period\n")
    result = made(tmp_path, text, effort=1)
    assert result.status == "ok" and result.check is not None
    assert float(result.check["bounds"]["period_max"]["proved"]) > 0.2139


@pytest.mark.parametrize("seeds", [range(20), range(20, 40)])
def test_random_schedules_are_proved_and_refuted_at_their_limit(seeds: range) -> None:
    """Within half a percent of the monodromy's limit on either side, never beyond it."""
    assert sum(is_met(seed) for seed in seeds) >= len(seeds) // 2


@pytest.mark.parametrize("seed", range(4))
def test_a_rate_is_that_of_the_monodromy(seed: int) -> None:
    question = filtered(random_schedule(seed))
    best = GENERAL.fastest(question, F(1, 500))
    assert best is not None
    rate = -np.log(radius(question, 0.2)) / float(question.law.hyperperiod)
    assert 0.99 * rate <= float(best.prove(question).rate) <= rate * (1 + 1e-9)


def test_a_plant_that_no_gain_observes_is_never_proved() -> None:
    """The unstable direction is seen by no sensor."""
    zero = [[0] * 3 for _ in range(3)]
    hidden = plant([[0, 1, 0], [-1, 0, 0], [0, 0, "0.5"]], zero, zero, [[1, 0, 0], [0, 1, 0]], doubled("0.2"))
    question = without_gain(hidden)
    assert design_graph(question) is None
    rng = np.random.default_rng(0)
    for _ in range(5):
        own = question.with_gain({"K": ExactMatrix.from_floats(rng.standard_normal(hidden.gain_shape), 4)})
        assert GENERAL.propose(own) is None
        witness = refute(own.inclusion, 1)
        assert witness is not None and refutes(own.inclusion, witness)


# ---------------------------------------------------------------- classes of slopes


def pendulums(law: SamplingLaw) -> Plant:
    """Two pendulums joined by a spring, of slopes in [-0.5, 0.5]: specs/lpv_zoh_two_outputs.yaml."""
    A = [[0, 1, 0, 0], ["-0.5", 0, "0.5", 0], [0, 0, 0, 1], ["0.5", 0, "-0.5", 0]]
    lower, upper = ([[0] * 4, [end, 0, 0, 0], [0] * 4, [0, 0, end, 0]] for end in ("-0.5", "0.5"))
    return plant(A, lower, upper, [[1, 0, 0, 0], [0, 0, 1, 0]], law)


@pytest.mark.parametrize(("scheme", "longest_of_a", "least"), [
    (staggered("1.2"), 1, 2.30), (doubled("0.8"), 2, 2.61), (doubled("0.8", "by_sensor"), 2, 2.61),
    (doubled("0.8", "one"), 2, 2.50), (staggered("1.2", "one"), 1, 2.30),
])  # fmt: skip
def test_two_pendulums(scheme: SamplingLaw, longest_of_a: int, least: float) -> None:
    """Theory, measurement schemes, (a): read together 2.13, staggered by half a period 2.30, theta1 at 2.62 with theta2
    at 1.31. Form W of `by_phase` and `by_sensor` (each set is read once a hyperperiod), form S and what is alike of W
    of `one`."""
    question = without_gain(pendulums(scheme))
    met = GraphGain().longest(question)
    assert met is not None and met.method is not None
    period, closed = float(met.law.period), question.under(met.law).with_gain({"K": met.gain})
    assert period * longest_of_a > least and met.method.prove(closed).holds
    if scheme.gains == "one":
        K = scheme.split(met.gain, 2)
        readers = [[q for q, phase in enumerate(scheme.phases) if k in phase.outputs] for k in range(2)]
        assert all(
            K[q].rows[i][k] == K[own[0]].rows[i][k] for k, own in enumerate(readers) for q in own for i in range(4)
        )
    worst = Counterexample.shortest(closed, met.law.period)
    assert worst is not None and worst.prove(closed).holds and float(worst.law.period) < 1.15 * period
    again = replay(closed.under(worst.law).inclusion, Witness.from_document(worst.witness))
    assert again.multiplier > 0.999


def test_read_together_is_the_simple_case() -> None:
    together = law("1.5", ("a", (0,), 1, 0), ("b", (1,), 1, 0))
    question = without_gain(pendulums(together))
    met = search.largest(lambda T: design_impulsive(question.at(T)), Exact("1.5"), F(1, 500))
    assert met is not None and float(met[0]) > 2.13


def staggered_pendulums() -> tuple[Question, ClockGraph]:
    question = without_gain(pendulums(staggered("1.5")))
    met = design_graph(question)
    assert met is not None and isinstance(met[1], ClockGraph)
    return question.with_gain({"K": met[0]}), met[1]


def test_a_certificate_is_of_its_gain_its_sensors_and_its_period_only() -> None:
    question, cycle = staggered_pendulums()
    assert cycle.prove(question).holds
    K = question.gain("K")
    flipped = ExactMatrix(
        [[-value if (i, j) == (1, 0) else value for j, value in enumerate(row)] for i, row in enumerate(K.rows)]
    )
    assert not cycle.prove(question.with_gain({"K": flipped})).holds
    swapped = law("1.5", ("a", (0,), 1, "1/2"), ("b", (1,), 1, 0))
    for other in (staggered("1.9"), swapped, doubled("1.5"), SamplingLaw.periodic(Exact("1.5"))):
        assert not replace(cycle, law=other).prove(question).holds
    shrunk = [
        [[f"0{entry}" if k else f"{float(entry) / 2}" for k, entry in enumerate(row)] for row in rows]
        for rows in cycle.P[:1]
    ]
    assert not replace(cycle, P=[*shrunk, *cycle.P[1:]]).prove(question).holds
    assert not replace(cycle, P=cycle.P[:-1]).prove(question).holds
    assert not replace(cycle, pieces=["1"]).prove(question).holds
    assert not replace(cycle, sigma="5").prove(question).holds


def test_certificates_of_one_jump_say_nothing_of_sensors_in_turn() -> None:
    question, cycle = staggered_pendulums()
    fields = {name: getattr(cycle, name) for name in ("degree", "elevated", "sigma", "basis", "P")}
    others = (
        Clock(cycle.law, pieces=["1", "0"], **fields),
        DeadBeat(cycle.law),
        CommonQuadratic(cycle.law, "1", "0", [["1"]]),
    )
    assert not any(other.prove(question).holds for other in others)
    with np.errstate(all="ignore"):
        assert np.isnan(question.inclusion.floats.jump).any(), "no one matrix is the jump"


def test_the_level_of_a_cycle_holds_along_runs() -> None:
    """|e_j(t)| of runs under bang-bang slopes stays below what the certificate says, and falls in its envelope."""
    question, cycle = staggered_pendulums()
    level, factor = cycle.level(question), cycle.factor(question)
    assert level is not None and factor is not None
    phases, gaps, rng = question.inclusion.phases_floats, question.law.gaps, np.random.default_rng(1)
    for _ in range(40):
        e0 = rng.standard_normal(4)
        e, sizes = phases[0].jump @ e0, []
        for k in range(24):
            for _ in range(4):
                v = rng.choice([-0.5, 0.5], 2)
                e = expm(phases[0].flow(tuple(v)) * float(gaps[k % 2]) / 4) @ e
                sizes.append(np.abs(e))
            e = phases[(k + 1) % 2].jump @ e
        V = float(max(e0 @ form.floats @ e0 for form in level.forms))
        ends = np.sqrt([float(reach) * V for reach in level.reach])
        assert (np.array(sizes) <= ends * (1 + 1e-9)).all()
        assert np.linalg.norm(np.array(sizes), axis=1).max() <= factor * np.linalg.norm(e0)


def test_a_word_keeps_to_the_sensors_times() -> None:
    question, cycle = staggered_pendulums()
    inclusion, zero = question.at(Exact("6")).inclusion, tuple(Exact("-0.5") for _ in range(2))
    word = Word(((Arc(Exact(3), zero),), (Arc(Exact(3), zero),)))
    assert prove(inclusion, word) is not None
    for other in (Word(word.periods[:1]), Word(word.periods + word.periods[:1]), Word(((Arc(Exact(6), zero),),)),
                  Word(((Arc(Exact(2), zero),), (Arc(Exact(4), zero),)))):  # fmt: skip
        assert prove(inclusion, other) is None
    assert refute(question.inclusion, 1) is None and cycle.prove(question).holds


def test_the_order_of_the_jumps_in_a_word_is_that_of_the_samples() -> None:
    """Three samples with three gains and three gaps: rho of the word's M beside the run written out."""
    scheme = law("0.4", ("a", (0,), 1, 0), ("b", (1,), 2, "1/4"))
    zero = [[0] * 2 for _ in range(2)]
    made_of = plant([["0.3", 1], [-1, "0.2"]], zero, zero, [[1, 0], [0, 1]], scheme)
    K = [["0.9", "0.1", "0.4"], ["0.2", "0.7", "-0.5"]]
    inclusion = Question(impulsive(made_of, K), effort=1).inclusion
    A, total = made_of.A.floats, np.eye(2)
    columns, jumps = np.array(K, dtype=float), []
    for q, output in enumerate([0, 1, 0]):
        jumps.append(np.eye(2) - np.outer(columns[:, q], made_of.C.floats[output]))
    for gap, jump in zip((0.1, 0.3, 0.4), (jumps[1], jumps[2], jumps[0]), strict=True):
        total = jump @ expm(A * gap) @ total
    rho = float(np.abs(np.linalg.eigvals(total)).max())
    proved = GENERAL.fastest(Question(inclusion), F(1, 1000)) if rho < 1 else None
    assert rho < 1 and proved is not None
    assert float(proved.prove(Question(inclusion)).rate) == pytest.approx(-np.log(rho) / 0.8, rel=2e-3)


# ---------------------------------------------------------------- no gain


def oscillator(T: Any, C: Any, *sensors: tuple[str, tuple[int, ...], Any, Any]) -> Plant:
    """Of period 0.4, undamped, beside a state that grows."""
    zero = [[0] * 3 for _ in range(3)]
    return plant([[0, "5*pi", 0], ["-5*pi", 0, 0], [0, 0, 0]], zero, zero, C, law(T, *sensors))


def test_sensors_in_step_with_an_oscillation_see_half_of_it() -> None:
    """Half a turn every 0.2: a sensor every 0.2 and one that sees the third state alone; every 0.1 sees all of it."""
    C = [[1, 0, 0], [0, 0, 1]]
    every = {"0.2": ("a", (0,), 2, 0), "0.1": ("a", (0,), 1, 0)}
    third = {"0.2": ("b", (1,), 1, 0), "0.1": ("b", (1,), 2, "1/2")}
    hidden = unseen(oscillator("0.1", C, every["0.2"], third["0.2"]))
    assert hidden is not None and abs(hidden.direction[1]) == 1 and abs(hidden.direction[0]) < 1e-9
    assert unseen(oscillator("0.1", C, every["0.1"], third["0.1"])) is None
    # The second sensor sees the oscillation too, a quarter of a turn later: together they see all of it.
    both, together = [[1, 0, 0], [1, 0, 1]], (("a", (0,), 2, 0), ("b", (1,), 2, 1))
    assert unseen(oscillator("0.1", both, *together)) is None
    # Of two sensors half a turn apart, neither does.
    apart = oscillator(
        "0.2", [[1, 0, 0], [1, 0, 0], [0, 0, 1]], ("a", (0,), 2, 0), ("b", (1,), 2, 1), ("c", (2,), 1, 0)
    )
    assert unseen(apart) is not None


def test_an_oscillation_that_is_not_seen_is_refuted_for_every_gain(tmp_path: Path) -> None:
    text = """\
spec_version: 1
plant: {states: [x, v, b], dynamics: [v, "-4*x", "0"]}
measurement: {sensors: {a: {output: [x], period: pi/2}, c: {output: [b], period: pi/4}}}
observer: {family: reachability}
"""
    result = made(tmp_path, text, ("check",))
    assert result.check is not None and result.check["verdict"] == "refuted"
    (claim,) = [one for one in result.check["claims"] if one["id"] == "convergence"]
    assert "sampled a every pi / 2, c every pi / 4, no measurement shows an error along v" in claim["statement"]
    seen = text.replace("output: [x]", "output: [v + b]").replace("output: [b]", "output: [x]")
    again = made(tmp_path, seen, ("check",))
    assert again.check is not None and again.check["verdict"] == "proved"
