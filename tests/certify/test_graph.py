"""The timed graph: sensors whose samples are lost, or that keep no step; certificates over it, words and runs of it."""

from __future__ import annotations

import os
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import made
from example_inclusions import canonical, impulsive, plant
from scipy.linalg import expm

from cdobs_cli.certificate import Witness
from cdobs_cli.certify.falsify import refute
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.graph import ClockGraph
from cdobs_cli.certify.methods.clock.graph_design import GraphGain, design_graph
from cdobs_cli.certify.methods.clock.graph_size import GraphPeak, sums
from cdobs_cli.certify.methods.counterexample import Counterexample
from cdobs_cli.certify.walks import walks
from cdobs_cli.certify.words import Word, prove, refutes
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.graph import MAX_NODES, graph
from cdobs_cli.hybrid import corrected_copy_noise
from cdobs_cli.plant import Box, Plant
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import Gains, Sensor
from cdobs_cli.simulate.signals import Draws
from cdobs_cli.simulate.walk import walker
from cdobs_cli.simulate.witness import replay

# Of the random graphs; a thousand of them take minutes.
GRAPHS = int(os.environ.get("CDOBS_GRAPHS", "30"))
F = Fraction


def lossy(T: Any, lost: int, gains: Gains = "by_phase") -> SamplingLaw:
    return SamplingLaw.multirate(Exact(T), [Sensor("y", (0,), F(1), lost=lost)], gains)


def apart(T: Any, gains: Gains = "by_phase") -> SamplingLaw:
    """T the longest of the first: between a half of it and it; the second between 5/3 and 10/3 of it."""
    sensors = [Sensor("a", (0,), F(1), least=F(1, 2)), Sensor("b", (1,), F(10, 3), least=F(5, 3))]
    return SamplingLaw.multirate(Exact(T), sensors, gains)


def rotor(law: SamplingLaw) -> Plant:
    """A growing rotation, with a slope that varies."""
    A, C = [["0.5", "0.6"], ["-0.6", "0.4"]], [[1, 0], [0, 1]]
    return plant(A, [[0, 0], ["-0.3", 0]], [[0, 0], ["0.3", 0]], C, law)


def without_gain(made_of: Plant) -> Question:
    rows, columns = made_of.gain_shape
    return Question(impulsive(made_of, [["0"] * columns] * rows), effort=1)


# ---------------------------------------------------------------- the graph


def test_losses_are_counted_in_nodes() -> None:
    timed = lossy("0.3", 3).graph
    assert len(timed.nodes) == 4 and len(timed.readings) == 4 and timed.start == (0, 0)
    assert [(edge.source, edge.target) for edge in timed.edges if edge.reading is None] == [(0, 1), (1, 2), (2, 3)]
    assert [(edge.source, edge.target) for edge in timed.edges if edge.reading is not None] == [
        (0, 0), (1, 0), (2, 0), (3, 0)
    ]  # fmt: skip


def test_of_two_sensors_every_pattern_of_losses_is_a_way() -> None:
    law = SamplingLaw.multirate(Exact("0.1"), [Sensor("a", (0,), F(1), lost=1), Sensor("b", (1,), F(2), F(1, 2), 2)])
    timed = law.graph
    # Three samples (a, b, a), of a 0 or 1 lost before, of b 0, 1 or 2.
    assert len(timed.nodes) == 3 * 2 * 3
    for lost in timed.edges:
        assert any(edge.reading is not None for edge in timed.leaving(lost.source))
    names = {one.name for one in timed.readings}
    assert names == {"a", "b"}


def test_ages_are_in_bins_that_cover_them() -> None:
    law = apart("1.2")
    timed, sensors = law.graph, law.sensors
    for node in timed.nodes:
        assert 0 < node.length <= min(one.every - low for one, (low, _) in zip(sensors, node.ages, strict=True))
        assert max(edge.high for edge in timed.edges if timed.nodes[edge.source] is node) == node.length
    draws, runs = Draws(1, 40), np.arange(40)
    walk, t = walker(law, draws, 40), np.zeros(40)
    last = np.zeros((2, 40))
    for k in range(60):
        node, after = walk.node.copy(), walk.after(runs, k, t)
        for r in range(40):
            edge = timed.into(int(walk.reading[r]))
            clock = (after[r] - t[r]) / 1.2
            assert edge.source == node[r] and edge.target == walk.node[r]
            assert float(edge.low) - 1e-9 <= clock <= float(edge.high) + 1e-9
            s = 0 if timed.readings[edge.reading or 0].name == "a" else 1
            gap = (after[r] - last[s, r]) / 1.2
            assert float(sensors[s].least or 0) - 1e-9 <= gap <= float(sensors[s].every) + 1e-9
            last[s, r] = after[r]
            ages = (after[r] - last[:, r]) / 1.2
            bins = [tuple(map(float, ends)) for ends in timed.nodes[edge.target].ages]
            assert all(low - 1e-9 <= age <= high + 1e-9 for age, (low, high) in zip(ages, bins, strict=True))
        t = after


def test_a_long_pattern_is_one_node() -> None:
    sensors = [Sensor("fast", (0,), F(1)), Sensor("slow", (1,), F(3600), F(3))]
    law = SamplingLaw.multirate(Exact(1), sensors)
    assert law.is_graph and len(law.graph.nodes) == 1 and [one.name for one in law.readings] == ["fast", "fast+slow"]
    walk, read = walker(law, Draws(0, 1), 1), []
    for k in range(4):
        assert walk.after(np.arange(1), k, np.array([float(k)])) == k + 1
        read.append(int(walk.reading[0]))
    assert read == [0, 0, 1, 0] and not walks(law)


def test_graphs_have_a_largest_size() -> None:
    many = [Sensor(f"s{k}", (k,), F(k + 1), lost=5) for k in range(6)]
    assert graph(many) is None
    with pytest.raises(ValueError, match="too much"):
        SamplingLaw.multirate(Exact(1), many)
    free = [Sensor(f"s{k}", (k,), F(10**k), least=F(1, 2)) for k in range(3)]
    timed = graph(free)
    assert timed is not None and len(timed.nodes) <= MAX_NODES
    assert graph([Sensor("a", (0,), F(1)), Sensor("b", (1,), F(10**6 + 1, 10**6))]) is None


ENTRY = {"name": "y", "outputs": [0], "every": "1", "offset": "0", "lost": 3}


@pytest.mark.parametrize("change", [
    {"lost": 0}, {"lost": 21}, {"lost": "3"}, {"lost": True}, {"least": "1/2"}, {"every": "2"}, {"more": 1},
])  # fmt: skip
def test_what_is_no_such_law(change: dict[str, Any]) -> None:
    law = lossy("0.3", 3)
    assert SamplingLaw.from_document(law.document()) == law == law.with_period(Exact("0.3"))
    assert SamplingLaw.from_document(apart("1.2").document()) == apart("1.2")
    with pytest.raises((ValueError, TypeError)):
        SamplingLaw.from_document(law.document() | {"sensors": [ENTRY | change]})


def test_what_the_law_holds() -> None:
    law = apart("1.2")
    assert law.words == "a 0.6 to 1.2 apart, b 2 to 4 apart"
    assert law.text("s") == "a 0.6 s to 1.2 s apart, b 2 s to 4 s apart"
    assert lossy("0.3", 2).words == "y every 0.3, at most 2 in a row lost"
    assert law.has_sensors and not (law.is_multirate or law.is_bounded or law.is_periodic or law.multiples)
    others = [SamplingLaw.periodic(Exact("1.2")), lossy("1.2", 1), replace(law, gains="one")]
    assert law.contains(law) and not any(law.contains(other) or other.contains(law) for other in others)


# ---------------------------------------------------------------- certificates


def test_gains_by_elapsed_time_bear_longer_gaps() -> None:
    """Three integrators in a row, |slope| <= 1: (m + 1) h = 1.34 with one gain, at least 1.5 with gains by what was
    lost."""
    met = GraphGain().longest(without_gain(canonical([1, 0, 0], lossy("0.37", 3))))
    assert met is not None and float(met.law.period) * 4 >= 1.5
    one = design_graph(without_gain(canonical([1, 0, 0], lossy("0.335", 3, "one"))))
    assert one is not None


def test_sensors_out_of_step() -> None:
    """The pair of the note: at least 5.4 for the longest period of the slower one, with gains by age; some word refutes
    the gain further on."""
    question = without_gain(rotor(apart("1.62")))
    met = design_graph(question)
    assert met is not None and float(question.law.T_max) * 10 / 3 >= 5.4
    closed = question.with_gain({"K": met[0]})
    assert met[1].prove(closed).holds and refute(closed.inclusion, 1) is None
    lost = refute(closed.at(Exact(3)).inclusion, 1)
    assert lost is not None and refutes(closed.at(Exact(3)).inclusion, lost)
    run = replay(closed.at(Exact(3)).inclusion, lost)
    assert run.multiplier >= float(lost.multiplier or 0) * (1 - 1e-6) >= 1 - 1e-6


def random_case(seed: int) -> tuple[Question, np.random.Generator]:
    rng = np.random.default_rng(seed)
    A = [[str(round(value, 2)) for value in row] for row in rng.uniform(-1, 1, (2, 2))]
    size = str(round(rng.uniform(0.05, 0.6), 2))
    T = str(round(float(np.exp(rng.uniform(-2, 0.7))), 3))
    kind = seed % 4
    if kind == 0:
        law, C = lossy(T, int(rng.integers(1, 4)), rng.choice(["by_phase", "one"])), [[1, 0]]
    elif kind == 1:
        sensors = [Sensor("a", (0,), F(1), lost=int(rng.integers(0, 2))), Sensor("b", (1,), F(2), F(1, 2), 1)]
        law, C = SamplingLaw.multirate(Exact(T), sensors, rng.choice(["by_phase", "by_sensor"])), [[1, 0], [0, 1]]
    else:
        parts = [F(int(k), 8) for k in rng.integers(1, 8, 2)]
        every = F(int(rng.integers(4, 16)), 4)
        sensors = [Sensor("a", (0,), F(1), least=parts[0]), Sensor("b", (1,), every, least=every * parts[1])]
        law, C = SamplingLaw.multirate(Exact(T), sensors, rng.choice(["by_phase", "by_sensor"])), [[1, 0], [0, 1]]
    return without_gain(plant(A, [[0, 0], ["-" + size, 0]], [[0, 0], [size, 0]], C, law)), rng


def test_nothing_proved_is_refuted_and_no_run_rises() -> None:
    """Of random graphs: along random ways and slopes the certificate's own function never rises, and no word is
    found."""
    proved = 0
    for seed in range(GRAPHS):
        question, rng = random_case(seed)
        met = design_graph(question.with_effort(0))
        if met is None or not isinstance(met[1], ClockGraph):
            continue
        proved += 1
        closed = question.with_gain({"K": met[0]})
        assert refute(closed.inclusion, 1) is None, seed
        falls_along_runs(closed, met[1], rng)
        shaken = ExactMatrix([[entry * Exact("1.7") for entry in row] for row in met[0].rows])
        other = question.with_gain({"K": shaken})
        certificate = ClockGraph.propose(other.with_effort(0))
        word = refute(other.inclusion, 1)
        assert certificate is None or word is None, seed
    assert proved >= GRAPHS // 4


def falls_along_runs(closed: Question, certificate: ClockGraph, rng: np.random.Generator) -> None:
    law, maps = closed.law, closed.inclusion.phases_floats
    back, shape = np.linalg.inv(certificate.S.floats), certificate.shape
    P = [back.T @ one.floats @ back for one in certificate.coefficients]
    runs = np.arange(8)
    walk, t = walker(law, Draws(int(rng.integers(1000)), 8), 8), np.zeros(8)
    corners = list(maps[0].corners())
    e = rng.standard_normal((8, 2))
    for k in range(30):
        starts = [P[shape.starts[node]] for node in walk.node]
        before = np.array([x @ M @ x for x, M in zip(e, starts, strict=True)])
        after = walk.after(runs, k, t)
        for r in range(8):
            parts = rng.dirichlet(np.ones(3)) * (after[r] - t[r])
            for part in parts:
                e[r] = expm(corners[rng.integers(len(corners))] * part) @ e[r]
            e[r] = maps[walk.reading[r]].jump @ e[r]
            V = e[r] @ P[shape.starts[walk.node[r]]] @ e[r]
            assert before[r] * (1 + 1e-7) >= V
        e, t = e / np.linalg.norm(e, axis=1)[:, None].clip(1e-300), after


def test_certificates_that_nobody_wrote_prove_nothing() -> None:
    question = without_gain(rotor(apart("1.2")))
    met = design_graph(question)
    assert met is not None and isinstance(met[1], ClockGraph)
    K, certificate = met
    closed = question.with_gain({"K": K})
    assert certificate.prove(closed).holds
    longer = replace(certificate, law=apart("4"))
    fewer = replace(certificate, pieces=certificate.pieces[:-1])
    small = replace(certificate, P=[[[str(-Exact(x)) for x in row] for row in one] for one in certificate.P])
    other = replace(certificate, pieces=[[*one, "1"] for one in certificate.pieces])
    for wrong in (longer, fewer, small, other, replace(certificate, degree="x"), replace(certificate, sigma="5")):
        assert not wrong.prove(closed).holds
    assert not certificate.prove(question.with_gain({"K": ExactMatrix([["0"] * K.shape[1]] * 2)})).holds


# ---------------------------------------------------------------- words


def test_words_are_ways_that_sensors_can_go() -> None:
    for law in (lossy("0.3", 3), apart("1.2")):
        found = walks(law)
        assert found and all(law.repeats(walk.gaps, walk.readings) for walk in found)
    law = lossy("0.3", 2)
    h = Exact("0.3")
    assert law.repeats([h, h, h], [None, None, 2]) and not law.repeats([h, h, h, h], [None, None, None, 2])
    assert not law.repeats([h, h], [None, 2]) and not law.repeats([h * Exact(2)], [1]) and not law.repeats([], [])
    away = walks(apart("1.2"))[0]
    law = apart("1.2")
    assert not law.repeats([gap * Exact(2) for gap in away.gaps], away.readings)
    assert not law.repeats(away.gaps, away.readings[::-1]) and not law.repeats(away.gaps, [None] * len(away.gaps))
    assert not SamplingLaw.periodic(h).repeats([h], [0])


def test_sensors_that_keep_a_step_have_begun_together() -> None:
    """Beside one that keeps none: read at multiples of their periods, and lost whole numbers of times."""
    free = Sensor("c", (2,), F(3), least=F(1))
    rigid = [Sensor("a", (0,), F(1), least=F(1)), Sensor("b", (1,), F(3, 2), least=F(3, 2)), free]
    lost = [Sensor("a", (0,), F(1), least=F(1)), Sensor("b", (1,), F(5, 2), lost=1, least=F(5, 4)), free]
    for sensors, step in ((rigid, F(1, 2)), (lost, F(1, 4))):
        law = SamplingLaw.multirate(Exact(1), sensors)
        assert SamplingLaw.from_document(law.document()) == law
        found, ages = walks(law), set()
        assert found
        for walk in found:
            assert law.repeats(walk.gaps, walk.readings)
            t, at = F(0), dict[str, list[F]]()
            for gap, reading in zip(walk.gaps * 2, walk.readings * 2, strict=True):
                t += gap.rational or 0
                at.setdefault(law.readings[reading or 0].name, []).append(t)
            assert all((a - b) % step == 0 for a in at["a"] for b in at["b"])
            ages |= {b - a for a, b in pairwise(at["b"])}
        assert ages <= {sensors[1].least, sensors[1].every}
        runs, draws = np.arange(20), Draws(1, 20)
        walk, t_k = walker(law, draws, 20), np.zeros(20)
        for k in range(40):
            t_k = walk.after(runs, k, t_k)
            steps = t_k[[law.readings[r].name == "b" for r in walk.reading]] / float(sensors[1].least or 1)
            assert np.allclose(steps, np.round(steps), atol=1e-9)
    together = [Sensor("a", (0,), F(1), least=F(1)), Sensor("b", (1,), F(1), least=F(1))]
    assert all(
        len(walk.gaps) == 2 and Exact(0) in walk.gaps for walk in walks(SamplingLaw.multirate(Exact(1), together))
    )
    for wrong in ({"lost": 3}, {"lost": 0}):
        entries = SamplingLaw.multirate(Exact(1), lost).document()
        entries["sensors"][1] |= wrong
        with pytest.raises(ValueError, match="no sensor"):
            SamplingLaw.from_document(entries)


def test_a_word_out_of_its_law_refutes_nothing() -> None:
    question = without_gain(canonical([1, 0, 0], lossy("0.5", 3)))
    closed = question.with_gain({"K": ExactMatrix([["1"] * 4, ["1"] * 4, ["0.5"] * 4])})
    witness = refute(closed.inclusion, 1)
    assert witness is not None and refutes(closed.inclusion, witness)
    word = Word.from_witness(Witness.from_document(witness.document()))
    assert prove(closed.inclusion, word) is not None
    assert prove(closed.inclusion, replace(word, readings=())) is None
    assert prove(closed.inclusion, replace(word, readings=(None,) * len(word.periods))) is None
    assert prove(closed.at(Exact("0.4")).inclusion, word) is None
    assert Counterexample(closed.law, witness.document()).prove(closed).holds


# ---------------------------------------------------------------- errors under noise


def test_sums_along_the_worst_way() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        n = int(rng.integers(1, 5))
        links = [(q, (q + 1) % n, float(rng.uniform(0.2, 1.0))) for q in range(n)]
        links += [(int(rng.integers(n)), int(rng.integers(n)), float(rng.uniform(0.2, 0.95))) for _ in range(4)]
        if n == 1:
            links[0] = (0, 0, 0.9)
        if np.prod([factor for _, _, factor in links[:n]]) > 0.9:
            continue
        added = list(rng.uniform(0, 1, len(links)))
        x = np.array(list(map(float, sums(n, links, added))))
        least = np.zeros(n)
        for _ in range(800):
            values = [factor * least[q] + own for (q, _, factor), own in zip(links, added, strict=True)]
            least = np.array([max(v for v, link in zip(values, links, strict=True) if link[1] == r) for r in range(n)])
        np.testing.assert_allclose(x, least, rtol=1e-6)


SPEC = """\
spec_version: 1
plant:
  states: [x, v]
  A: [[0, 1], [0, -0.1]]
  phi: ["0", "0"]
  lipschitz: [[0, 0], [0, 0]]
measurement:
  sensors:
    camera: {C: [[1, 0]], period: 0.5, offset: 0.1, lost: {at_most: 3}, noise: {lower: [-0.05], upper: [0.05]}}
    gyro: {C: [[0, 1]], period: 0.25, noise: {lower: [-0.01], upper: [0.01]}}
observer: {family: reachability}
simulation: {horizon: 30, initial_box: {lower: [-1, -1], upper: [1, 1]}, runs: 40, initial_estimate: [0, 0]}
"""


def test_sensors_with_losses_run(tmp_path: Path) -> None:
    """Proved, and no error of forty runs beyond its bound in the long run."""
    result = made(tmp_path, SPEC, effort=1)
    assert result.status == "ok" and result.check is not None and result.simulation is not None
    bounds = result.check["bounds"]
    with np.load(tmp_path / "out" / "simulation.npz") as stored:
        t, error = stored["t"], np.abs(stored["x_hat"] - stored["x"])
        late = error[t > 20].max(axis=0)
        y = stored["y_k"]
        assert np.isnan(y).any(axis=0).all() and not np.isnan(y).all(axis=1).any()
    for k, name in enumerate(("x", "v")):
        proved = float(bounds[f"error.{name}"]["proved"])
        assert late[k] <= proved <= 20 * late[k]


@pytest.mark.parametrize(("change", "told"), [
    (("period: 0.25", "min_period: 0.1, max_period: 0.25"), "offset: goes with sensors that all have a period"),
    (("period: 0.25", "min_period: 0.1, max_period: 0.25, offset: 0"), "offset: goes with a period"),
    (("at_most: 3", "probability: 0.3"), "the losses in a row are taken"),
    (("at_most: 3", "at_most: 21"), "at most 20 is expected"),
    (("period: 0.25", "max_period: 0.25"), "min_period: is required"),
    (("period: 0.25", "period: 0.25, max_period: 0.3, min_period: 0.1"), "does not go with"),
    (("period: 0.25", "min_period: 0.3, max_period: 0.25"), "min_period is above max_period"),
    (("period: 0.25", "period: 0.03"), "too many patterns of losses"),
    (("period: 0.25", "period: 0.1201"), "the sensors are read as before only after 600.5"),
    (("reachability", "lpv_zoh"), "family reachability takes"),
])  # fmt: skip
def test_wrong_sensors_are_told(tmp_path: Path, change: tuple[str, str], told: str) -> None:
    assert change[0] in SPEC
    result = made(tmp_path, SPEC.replace(*change), ("check",))
    assert result.status == "invalid"
    assert any(told in f"{one.field}: {one.text}" and one.line for one in result.messages), result.messages


def test_gains_by_elapsed_time_are_asked_for(tmp_path: Path) -> None:
    """`gains: by_phase` beside lost samples: a gain for each number of samples lost before."""
    alone = SPEC.replace(
        SPEC[SPEC.index("  sensors:") : SPEC.index("observer")],
        """\
  C: [[1, 0]]
  sampling: {period: 0.5}
  lost: {at_most: 2}
  gains: by_phase
""",
    )
    result = made(tmp_path, alone, effort=0)
    assert result.status == "ok" and result.design is not None
    assert len(result.design["gain"]["K"][0]) == 3 and result.design["sampling"]["sensors"][0]["lost"] == 2
    wrong = made(tmp_path, alone.replace("  lost: {at_most: 2}\n", ""), ("check",))
    assert wrong.status == "invalid" and any("goes with `sensors`, or with lost" in one.text for one in wrong.messages)


def test_bounds_of_errors_hold_along_the_worst_signals() -> None:
    """Of the growing rotation, sensors out of step and bounded noise: random ways, slopes and signs of noise."""
    noise = Box((Exact("-0.1"), Exact("-0.2")), (Exact("0.1"), Exact("0.2")))
    made_of = replace(rotor(apart("0.8")), noise=noise)
    rows, columns = made_of.gain_shape
    start = impulsive(made_of, [["0"] * columns] * rows)
    question = Question(replace(start, assemble_noise=corrected_copy_noise), effort=1)
    met = design_graph(question.with_rate(F(1, 5)))
    assert met is not None
    closed = question.with_gain({"K": met[0]})
    bounds = []
    for i in range(2):
        bound = GraphPeak.propose(closed.of_state(i))
        assert bound is not None
        error = bound.prove(closed.of_state(i)).error
        assert error is not None
        bounds.append(float(error))
    rng, maps, kicks = np.random.default_rng(4), closed.inclusion.phases_floats, closed.inclusion.phases_noise_floats
    runs, most = np.arange(30), np.zeros(2)
    walk, t, e = walker(closed.law, Draws(2, 30), 30), np.zeros(30), np.zeros((30, 2))
    corners = list(maps[0].corners())
    for k in range(80):
        after = walk.after(runs, k, t)
        for r in runs:
            for part in rng.dirichlet(np.ones(2)) * (after[r] - t[r]):
                e[r] = expm(corners[rng.integers(2)] * part) @ e[r]
            most = np.maximum(most, np.abs(e[r]))
            J, G = maps[walk.reading[r]].jump, kicks[walk.reading[r]].kick
            v = np.sign(G.T @ (J @ e[r])) if rng.random() < 0.8 else rng.choice([-1, 1], 2)
            e[r] = J @ e[r] + G @ (np.array([0.1, 0.2]) * v)
            most = np.maximum(most, np.abs(e[r]))
        t = after
    assert np.all(most <= bounds) and np.all(most >= np.array(bounds) / 20)
