"""A spec's blocks: what good ones become, and what is said of every kind of mistake."""

# ruff: noqa: E501 - each case stands on one line

from __future__ import annotations

import json
import os
import subprocess
import sys
from fractions import Fraction

import pytest
from spec_pendulum import PENDULUM, changed

from cdobs_cli.errors import SpecError
from cdobs_cli.exact.expression import Call, Number, Variable
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.exact.parser import parse
from cdobs_cli.plant import Interval
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.spec.model import load

HEAD = "spec_version: 1\n"


def test_a_good_spec_becomes_its_nouns(loaded):
    spec = loaded()
    plant = spec.plant
    assert (spec.title, plant.states, [source.name for source in plant.inputs]) == (
        "Pendulum",
        ("theta", "omega"),
        ["u"],
    )
    assert plant.inputs[0].range == Interval(Exact(-1), Exact(1))
    assert plant.B is not None and plant.B[1, 0].rational == Fraction(1, 8)
    assert plant.phi[1] == Call("sin", (Variable("theta"),)) / Number(1)
    assert plant.slopes.lower.texts() == [["0", "0"], ["-1", "0"]]
    assert plant.domain.box == {"theta": Interval(Exact(-4), None)}
    assert [str(part) for part in plant.domain.where] == [str(parse("2*theta + 10 - omega", frozenset(plant.states)))]
    assert plant.disturbance is not None and plant.disturbance.lower[1].rational == Fraction(-1, 1000)
    assert plant.sampling == SamplingLaw.periodic(Exact("0.6"))
    assert spec.observer.family == "reachability"
    assert spec.observer.gain.K.texts() == [["1"], ["1.8361"]]
    run = spec.simulation
    assert run is not None and (run.runs, run.seed, run.horizon) == (3, 7, Exact(20))
    assert set(run.signals) == {"u", "d.0", "d.1", "v.0"}
    assert run.signals["v.0"] == Call("uniform", (Number(Fraction(-1, 100)), Number(Fraction(1, 100))))
    assert run.sampling_times is not None and run.sampling_times.variables == {"t"}
    assert [str(entry) for entry in spec.expect] == ["bounds.period_max.proved at least 0.6"]
    assert spec.location(("plant", "A", 0, 1))[1:] == (7, 11)
    assert spec.location(spec.expect[0].field)[1:] == (29, 5)


def test_exact_numbers_stay_exact_everywhere(loaded):
    spec = loaded(("period: 0.6", 'period: "pi/8"'), ("horizon: 20", 'horizon: "2*sqrt(2)"'))
    assert str(spec.plant.sampling.T_max) == str(Exact("pi/8"))
    assert spec.simulation is not None and str(spec.simulation.horizon) == "2 * sqrt(2)"


@pytest.mark.parametrize(
    ("typed", "law"),
    [
        ("{min_period: 0.1, max_period: 1e0}", SamplingLaw("aperiodic", Exact("0.1"), Exact(1))),
        ("{max_period: 1}", SamplingLaw("aperiodic", Exact(0), Exact(1))),
        ("{min_period: 1, max_period: 1}", SamplingLaw.periodic(Exact(1))),
    ],
)
def test_sampling_laws(loaded, typed, law):
    assert loaded(("{period: 0.6}", typed)).plant.sampling == law


@pytest.mark.parametrize(
    ("typed", "lower", "upper", "auto"),
    [
        ("auto", [["0", "0"], ["0", "0"]], [["0", "0"], ["0", "0"]], {(1, 0)}),  # phi depends on nothing else
        ('[[0, auto], [auto, [-0.5, "1/3"]]]', [["0", "0"], ["0", "-0.5"]], [["0", "0"], ["0", "1/3"]], {(1, 0)}),
        ("[[0, 0], [k, 0]]", [["0", "0"], ["-2", "0"]], [["0", "0"], ["2", "0"]], set()),
    ],
)
def test_forms_of_the_slopes(loaded, typed, lower, upper, auto):
    slopes = loaded(("lipschitz: [[0, 0], [1, 0]]", f"lipschitz: {typed}")).plant.slopes
    assert (slopes.lower.texts(), slopes.upper.texts(), set(slopes.auto)) == (lower, upper, auto)


def test_normalised_content_ignores_what_does_not_matter_and_sees_what_does(loaded):
    base = loaded().normalised()
    same = loaded(
        ("title: Pendulum\n", "title: Another # comment\n"),
        ("period: 0.6}", "period: 6e-1}"),
        ("[1, 0]]\n  domain", '["2/2", 0.0]]\n  domain'),
    )
    assert json.dumps(base, sort_keys=True) == json.dumps(same.normalised(), sort_keys=True)
    for old, new, section in [
        ("period: 0.6}", "period: 0.61}", "measurement"), ("[1.8361]", "[1.8362]", "observer"), ("g: 1,", "g: 1.5,", "plant"),
        ("horizon: 20", "horizon: 21", "simulation"), ("seed: 7", "seed: 8", "simulation"), ("null]", "7]", "plant"),
    ]:  # fmt: skip
        other = loaded((old, new)).normalised()
        assert [name for name in base if base[name] != other[name]] == [section]


def test_minimal_spec(write):
    text = (
        HEAD
        + "plant: {states: [x], A: [[0]], phi: ['0'], lipschitz: [[0]]}\nmeasurement: {C: [[1]], sampling: {period: 1}}\nobserver: {family: reachability}\n"
    )
    spec = load(write(text, "tank.yaml"))
    assert (spec.title, spec.simulation, spec.expect) == ("tank", None, ())


# One mistake each: what replaces what, and the whole sentence.
MISTAKES = [
    ("spec_version: 1", "spec_version: 2", '1:15: spec_version: one of a few values is expected; got 2; allowed: 1'),
    ("spec_version: 1\n", "", "1:1: spec_version: is required"),
    ("title: Pendulum", "titel: Pendulum", "2:1: titel: unknown key; allowed: expect, measurement, observer, plant, report, simulation, spec_version, title; did you mean 'title'?"),
    ("title: Pendulum", "title: 3.5", "2:8: title: text is expected, put it in quotes; got 3.5"),
    ("title: Pendulum", "title: 2014", "2:8: title: text is expected; got 2014; put it in quotes"),
    ("states: [theta, omega]", "states: [theta, 2x]", '4:19: plant.states[1]: a name is a letter followed by letters, digits and _, at most 32 in all; got "2x"'),
    ("states: [theta, omega]", "states: theta", '4:11: plant.states: a list is expected; got "theta"; write states: ["theta"]'),
    ("{u: {range: [-1, 1]}}", "{sin: {range: [-1, 1]}}", "5:12: plant.inputs.sin: the name sin is reserved; got {range: [-1, 1]}\n26:12: simulation.signals: the input sin has no signal; add sin: \"0\", or an expression of t\n26:13: simulation.signals.u: unknown key; allowed: sin, d, v"),
    ("{u: {range: [-1, 1]}}", "{u: {range: [1, -1]}}", "5:23: plant.inputs.u.range: the lower end is above the upper end; got [1, -1]"),
    ("{u: {range: [-1, 1]}}", "{u: {range: [1]}}", "5:23: plant.inputs.u.range: two ends are expected: [lower, upper]; got [1]"),
    ("{u: {range: [-1, 1]}}", "{u: {rnge: [1]}}", "5:16: plant.inputs.u.rnge: unknown key; allowed: range; did you mean 'range'?"),
    ("{g: 1, k:", "{theta: 1, g: 1, k:", "6:16: plant.parameters.theta: the name theta is already one of the states"),
    ('k: "2*g"', 'k: "2*h"', """6:25: plant.parameters.k: unknown name 'h'; known: e, g, pi (at character 3); got "2*h"; a constant is declared in plant.parameters: {h: number}"""),
    ("A: [[0, 1], [0, 0]]", "A: [[0, 1, 2], [0, 0, 0]]", "7:6: plant.A: a matrix of another shape is expected; got 2 x 3; allowed: 2 x 2, a row and a column for each state"),
    ("A: [[0, 1], [0, 0]]", "A: [[0, 1], [0]]", "7:6: plant.A: rows of one length are expected, these have 2, 1; got [[0, 1], [0]]"),
    ("A: [[0, 1], [0, 0]]", "A: [[0, one], [0, 0]]", """7:11: plant.A[0][1]: unknown name 'one'; known: e, g, k, pi; got "one"; a constant is declared in plant.parameters: {one: number}"""),
    ("A: [[0, 1], [0, 0]]", "A: [[0, .NaN], [0, 0]]", "7:11: plant.A[0][1]: a finite number is expected; got .NaN; leave an open end of an interval out with null"),
    ("A: [[0, 1], [0, 0]]", 'A: [[0, "9**9**9"], [0, 0]]', """7:11: plant.A[0][1]: an exponent p/q is at most 64 in size, with q at most 1000000 (at character 4); got "9**9**9\""""),
    ("A: [[0, 1], [0, 0]]", 'A: [[0, 1e101], [0, 0]]', "7:11: plant.A[0][1]: a number beyond 1e100; got 1e101"),
    ("A: [[0, 1], [0, 0]]", 'A: [[0, 1e-101], [0, 0]]', "7:11: plant.A[0][1]: a number below 1e-100 that is not zero; got 1e-101"),
    ("A: [[0, 1], [0, 0]]", 'A: [[0, "sqrt(-1)"], [0, 0]]', '7:11: plant.A[0][1]: sqrt(-1) has no finite value; got "sqrt(-1)"'),
    ("A: [[0, 1], [0, 0]]", 'A: [[0, "1/(2-2)"], [0, 0]]', '7:11: plant.A[0][1]: division by zero; got "1/(2-2)"'),
    ("A: [[0, 1], [0, 0]]", 'A: [[0, true], [0, 0]]', "7:11: plant.A[0][1]: a number is expected; got true"),
    ("A: [[0, 1], [0, 0]]", 'A: 0', "7:6: plant.A: a matrix is expected: a list of rows, each a list; got 0; write A: [[0]]"),
    ("  A: [[0, 1], [0, 0]]\n", '', "4:3: plant.A: is required; or type the plant as `dynamics` and `output`"),
    ('["0", "sin(theta)/g"]', '["0"]', "8:8: plant.phi: one expression for each state is expected; got 1 entries; allowed: 2 entries"),
    ('["0", "sin(theta)/g"]', '["0", "sin(thet)"]', """8:14: plant.phi[1]: unknown name 'thet', did you mean 'theta'?; known: e, g, k, omega, pi, theta, u (at character 5); got "sin(thet)\""""),
    ('["0", "sin(theta)/g"]', '["0", "__import__(\'os\')"]', None),
    ('["0", "sin(theta)/g"]', '["0", "theta.real"]', """8:14: plant.phi[1]: only + - * / **, numbers, names and functions are allowed; got "theta.real\""""),
    ('["0", "sin(theta)/g"]', '["0", [1]]', "8:14: plant.phi[1]: an expression is expected; got [1]"),
    ('["0", "sin(theta)/g"]', '["0", "uniform(0, 1)"]', None),
    ('["0", "sin(theta)/g"]', '["0", "1e300*theta"]', '8:14: plant.phi[1]: a number beyond 1e100; got "1e300*theta"'),
    ('B: [[0], ["1/8"]]', "B: [[0, 1]]", "9:6: plant.B: a matrix of another shape is expected; got 1 x 2; allowed: 2 x 1, a row for each state, a column for each input"),
    ("[[0, 0], [1, 0]]\n  domain", "[[0, 0], [1]]\n  domain", "10:23: plant.lipschitz[1]: one slope for each state is expected; got 1 entries; allowed: 2 entries"),
    ("[[0, 0], [1, 0]]\n  domain", "[[0, 0], [-1, 0]]\n  domain", "10:24: plant.lipschitz[1][0]: a bound of an absolute value is not negative; write [lower, upper] for a range; got -1"),
    ("[[0, 0], [1, 0]]\n  domain", "[[0, 0], [[2, 1], 0]]\n  domain", "10:24: plant.lipschitz[1][0]: the lower end is above the upper end; got [2, 1]"),
    ("[[0, 0], [1, 0]]\n  domain", "otto\n  domain", """10:14: plant.lipschitz: one of a few values is expected; got "otto"; allowed: auto"""),
    ("theta: [-4, null]", "thet: [-4, null]", "11:12: plant.domain.thet: unknown key; allowed: theta, omega, where; did you mean 'theta'?"),
    ("theta: [-4, null]", "theta: [4, -4]", "11:19: plant.domain.theta: the lower end is above the upper end; got [4, -4]"),
    ("omega <= k*theta + 10", "omega*theta <= 1", '11:39: plant.domain.where[0]: a side that is not affine in the states (slopes need a convex domain); got "omega*theta <= 1"'),
    ("omega <= k*theta + 10", "omega < 1", '11:39: plant.domain.where[0]: an inequality of two or more sides is expected, all joined by <= or all by >=; got "omega < 1"'),
    ("lower: [0, -1e-3]", "lower: [0]", "12:24: plant.disturbance.lower: one number for each state is expected; got 1 numbers; allowed: 2 numbers"),
    ("lower: [0, -1e-3]", "lower: [0, 1]", "12:28: plant.disturbance.lower[1]: the lower end is above the upper end; got 1; allowed: at most 0.5"),
    ("C: [[1, 0]]", "C: [[1, 0, 0]]", "14:6: measurement.C: a matrix of another shape is expected; got 1 x 3; allowed: 1 x 2, a column for each state"),
    ("  C: [[1, 0]]\n", "", "14:3: measurement.C: is required"),
    ("period: 0.6", "period: -0.6", "15:22: measurement.sampling.period: a positive number is expected; got -0.6"),
    ("period: 0.6", "period: 0", "15:22: measurement.sampling.period: a positive number is expected; got 0"),
    ("period: 0.6", "perod: 0.6", "15:14: measurement.sampling.perod: unknown key; allowed: max_period, min_period, period, updated; did you mean 'period'?"),
    ("{period: 0.6}", "{min_period: 2, max_period: 1}", "15:26: measurement.sampling.min_period: min_period is above max_period; got 2; allowed: at most 1"),
    ("{period: 0.6}", "{period: 0.6, max_period: 1}", None),
    ("{period: 0.6}", "{updated: false}", "15:23: measurement.sampling.updated: one of a few values is expected; got false; allowed: true"),
    ("lower: [-0.01]", "lower: [0, 0]", "16:18: measurement.noise.lower: one number for each output is expected; got 2 numbers; allowed: 1 numbers"),
    ("family: reachability", "family: reachabilty", None),
    ("  family: reachability\n", "", None),
    ("gain: {K:", "gain: {L:", None),
    ("horizon: 20", "horizon: 0", "21:12: simulation.horizon: a positive number is expected; got 0"),
    ("horizon: 20", "horizon: 1e9", "21:12: simulation.horizon: too many samples; got 1000000000; allowed: at most 1000000 periods"),
    ("initial_state: [1, 0]", "initial_state: [1]", "22:18: simulation.initial_state: one number for each state is expected; got 1 entries; allowed: 2 entries"),
    ("  initial_state: [1, 0]\n", "", "21:3: simulation.initial_state: is required, or initial_box"),
    ("initial_state: [1, 0]", "initial_state: [1, 0]\n  initial_box: {lower: [0, 0], upper: [0.5, 1]}", "22:19: simulation.initial_state[0]: lies outside initial_box; got 1; allowed: 0 to 0.5"),
    ("runs: 3", "runs: true", "24:9: simulation.runs: an integer is expected; got true"),
    ("runs: 3", "runs: 0", "24:9: simulation.runs: a number of at least 1 is expected; got 0"),
    ("seed: 7", "seed: 1.5", "25:9: simulation.seed: an integer is expected; got 1.5"),
    ('u: "0.3 + 0.1*sin(t)", ', "", "26:12: simulation.signals: the input u has no signal; add u: \"0\", or an expression of t"),
    ('u: "0.3 + 0.1*sin(t)"', 'u: "0", w: "1"', "26:21: simulation.signals.w: unknown key; allowed: u, d, v"),
    ('u: "0.3 + 0.1*sin(t)"', 'u: "thetta"', None),
    ('u: "0.3 + 0.1*sin(t)"', 'u: "normal(1)"', None),
    ('d: [0, "1e-3*cos(t)"]', "d: [0]", "26:39: simulation.signals.d: one expression for each state is expected; got 1 entries; allowed: 2 entries"),
    ("  disturbance: {lower: [0, -1e-3], upper: [0, .5]}\n", "", "25:39: simulation.signals.d: needs plant.disturbance, which is not given"),
    ("  noise: {lower: [-0.01], upper: [0.01]}\n", "", "25:62: simulation.signals.v: needs measurement.noise, which is not given"),
    ("uniform(-0.01, 0.01)", "uniform(1, 0)", "26:63: simulation.signals.v[0]: the lower end is above the upper end; got uniform(1, 0)"),
    ("uniform(-0.01, 0.01)", "normal(-1)", "26:63: simulation.signals.v[0]: a deviation is not negative; got normal(-1)"),
    ("{period: 0.6}", "{updated: true, perod: 1}", "15:29: measurement.sampling.perod: unknown key; allowed: max_period, min_period, period, updated; did you mean 'period'?"),
    ("sin(t_k)", "sin(t)", """27:19: simulation.sampling_times: unknown name 't'; known: e, g, k, pi, t_k (at character 15); got "0.6 + 0.1*sin(t)"; the time of a sample is t_k"""),
    ("at_least: 0.6, ", "", "29:5: expect[0]: one relation is expected; got none; allowed: at_least, at_most or equals"),
    ("at_least: 0.6, ", "at_least: 0.6, at_most: 1, ", "29:5: expect[0]: one relation is expected; got at_least, at_most; allowed: at_least, at_most or equals"),
    ("at_least: 0.6, ", "at_least: 0.6, tolerance: 1, ", "29:68: expect[0].tolerance: goes with equals and a number"),
    ("bounds.period_max.proved", "bound.period_max.proved", None),
    ("at_least: 0.6", "atleast: 0.6", None),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "told"), [case for case in MISTAKES if case[2] is not None])
def test_every_mistake_has_its_place_and_its_sentence(mistakes, old, new, told):
    text = changed((old, new)) if PENDULUM.count(old) == 1 else pytest.fail(old)
    assert "\n".join(mistakes(text)) == told


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ('"sin(theta)/g"', "\"__import__('os').system('x')\"", ["8:14: plant.phi[1]: unknown function"]),
        ('"sin(theta)/g"', '"uniform(0, 1)"', ["8:14: plant.phi[1]: unknown function 'uniform'"]),
        ('"sin(theta)/g"', '"' + "(" * 300 + "1" + ")" * 300 + '"', ["nested at most 100 deep"]),
        ('"sin(theta)/g"', '"' + "+".join(["theta"] * 400) + '"', ["at most 2000 characters"]),
        (
            "{period: 0.6}",
            "{period: 0.6, max_period: 1}",
            ["15:13: measurement.sampling: one law is expected, these are 2", "{max_period: 1}"],
        ),
        (
            "family: reachability",
            "family: reachabilty",
            ["18:11: observer.family: unknown family", "did you mean 'reachability'?"],
        ),
        ("  family: reachability\n", "", ["18:3: observer.family: is required; allowed: ", "reachability"]),
        (
            "gain: {K:",
            "gain: {L:",
            ["19:10: observer.gain.L: unknown key; allowed: K; the gain of reachability is K, a jump at samples"],
        ),
        ('u: "0.3 + 0.1*sin(t)"', 'u: "thetta"', ["26:16: simulation.signals.u: unknown name 'thetta'"]),
        ('u: "0.3 + 0.1*sin(t)"', 'u: "normal(1)"', ["26:16: simulation.signals.u: unknown function 'normal'"]),
        (
            "bounds.period_max.proved",
            "bound.period_max.proved",
            ["29:16: expect[0].quantity: no such quantity", "did you mean 'bounds'?"],
        ),
        ("at_least: 0.6", "atleast: 0.6", ["29:42: expect[0].atleast: unknown key", "did you mean 'at_least'?"]),
    ],
)
def test_mistakes_whose_sentence_depends_on_other_parts(mistakes, old, new, parts):
    told = "\n".join(mistakes(changed((old, new))))
    for part in parts:
        assert part in told


def test_all_mistakes_of_a_file_at_once_in_the_order_of_the_text(mistakes):
    told = mistakes(
        changed(
            ("title: Pendulum", "titel: Pendulum"), ("phi: [\"0\", \"sin(theta)/g\"]", 'phi: ["0", "sin(thet)"]'), ("C: [[1, 0]]", "C: [[1]]"),
            ("period: 0.6", "period: -1"), ("K: [[\"1\"]", "K: [[x]"), ("horizon: 20", "horizon: .inf"), ("runs: 3", "runs: 3\n  runs: 4"),
            ("at_least: 0.6", "at_least: half"),
        )
    )  # fmt: skip
    fields = [line.split(": ")[1] for line in told]
    assert fields == [
        "titel", "plant.phi[1]", "measurement.C", "measurement.sampling.period", "observer.gain.K[0][0]", "simulation.horizon",
        "simulation.runs", "expect[0].at_least",
    ]  # fmt: skip
    lines = [int(line.split(":")[0]) for line in told]
    assert lines == sorted(lines)


@pytest.mark.parametrize("text", ["", "# nothing\n", "[]", "1", "null", "just words", "- a\n- b"])
def test_files_that_hold_no_mapping(mistakes, text):
    (told,) = mistakes(text)
    assert "a mapping is expected" in told


def test_blocks_that_are_no_mappings(mistakes):
    told = "\n".join(
        mistakes("spec_version: 1\nplant: 3\nmeasurement: []\nobserver: x\nsimulation: [1]\nexpect: {a: 1}\n")
    )
    for place in ("2:8: plant:", "3:14: measurement:", "4:11: observer:", "5:13: simulation:", "6:9: expect:"):
        assert place in told


def test_large_matrices_are_refused(mistakes):
    rows = "[" + ", ".join("[" + ", ".join(["0"] * 40) + "]" for _ in range(40)) + "]"
    states = "[" + ", ".join(f"x{i}" for i in range(40)) + "]"
    told = mistakes(changed(("A: [[0, 1], [0, 0]]", f"A: {rows}"), ("[theta, omega]", states)))
    assert any("4:11: plant.states: a list of 1 to 32 entries is expected, this one has 40" in line for line in told)


def test_no_more_than_a_hundred_mistakes_are_shown(mistakes):
    rows = "[" + ", ".join("[" + ", ".join(["thet"] * 200) + "]" for _ in range(90)) + "]"
    told = mistakes(changed(("A: [[0, 1], [0, 0]]", f"A: {rows}")))
    assert len(told) == 101
    assert told[-1].strip() == "spec: 17900 more mistakes are not shown"


def test_parameters_cannot_grow_beyond_use(mistakes):
    chain = ", ".join(f'p{i}: "p{i - 1}*p{i - 1}+sin(p{i - 1})"' for i in range(1, 60))
    told = mistakes(changed(("g: 1, k:", f'p0: "sin(1)", {chain}, g: 1, k:')))
    assert any("too large" in line for line in told)


# -- a plant in a file of its own ------------------------------------------------------------------------

PLANT_FILE = "".join(line[2:] for line in PENDULUM.splitlines(keepends=True)[3:12])
OTHERS = PENDULUM.split("measurement:")[1]


def with_file(name: str) -> str:
    return f"spec_version: 1\nplant: {{file: {name}}}\nmeasurement:{OTHERS}"


def test_a_plant_file_is_read_beside_the_spec(write, loaded):
    path = write(PLANT_FILE, "pendulum.plant.yaml")
    spec = load(write(with_file("pendulum.plant.yaml")))
    assert spec.normalised() == loaded().normalised()
    assert spec.location(("plant", "A", 0, 1)) == (str(path), 4, 9)


def test_mistakes_in_a_plant_file_name_that_file(write):
    path = write(
        PLANT_FILE.replace("sin(theta)/g", "sin(thet)").replace("u: {range", "u: &x {range"), "pendulum.plant.yaml"
    )
    with pytest.raises(SpecError) as caught:
        load(write(with_file("pendulum.plant.yaml").replace("period: 0.6", "period: -1")))
    told = str(caught.value).splitlines()
    assert [line.split(": ")[:2] for line in told[1:]] == [
        [f"{path}:2:13", "plant.inputs.u"],
        [f"{path}:5:12", "plant.phi[1]"],
    ]
    assert "measurement.sampling.period" in told[0]


@pytest.mark.parametrize(
    ("name", "content", "part"),
    [
        ("missing.yaml", None, "2:15: plant.file: no such file"),
        (".", None, "2:15: plant.file: a plant's file is a YAML file"),
        ("p.plant.yaml", "a: [", "p.plant.yaml:1:5: plant.file: not YAML"),
        ("p.plant.yaml", "file: p.plant.yaml", "p.plant.yaml:1:1: plant.file: a plant's file names no further file"),
        ("p.plant.yaml", "[1]", "2:15: plant.file: the file holds no plant"),
        ("3", None, "2:15: plant.file: a file name is expected; got 3"),
        ("p.plant.yaml, A: 1", "states: [x]", "2:32: plant.A: goes into the plant's file"),
    ],
)
def test_plant_files_that_are_wrong(write, name, content, part):
    if content is not None:
        write(content, "p.plant.yaml")
    with pytest.raises(SpecError) as caught:
        load(write(with_file(name)))
    assert part in str(caught.value)


SECRET = "hunter2"


def refused_plant(write, tmp_path, name):
    """What is told of a spec that names this plant file: at the line of the name, and nothing of any file."""
    folder = tmp_path / "specs"
    folder.mkdir(exist_ok=True)
    spec = write(with_file(name), "specs/spec.yaml")
    with pytest.raises(SpecError) as caught:
        load(spec)
    (problem,) = caught.value.problems
    assert SECRET not in str(problem)
    assert (problem.file, problem.path) == (str(spec), "plant.file")
    assert problem.line == 2
    return problem.text


@pytest.mark.parametrize(
    "content",
    [f"root: {SECRET}", f"{SECRET}", f"- {SECRET}", f"*{SECRET}", f"&{SECRET} 1", f"!{SECRET} 1", f"{SECRET}: .nan", f"token: {SECRET}\nA: [[1]]"],
)  # fmt: skip
def test_nothing_is_quoted_of_a_file_that_is_no_plant(write, tmp_path, content):
    (tmp_path / "specs").mkdir()
    write(content, "specs/secret.yaml")
    assert refused_plant(write, tmp_path, "secret.yaml") == "the file holds no plant; allowed: a mapping with `states`"


@pytest.mark.parametrize("content", [f"a: [{SECRET}", f"{SECRET}: !{SECRET}!x 1", f"a: '{SECRET}", f'a: "\\{SECRET}"'])
def test_nothing_is_quoted_of_a_file_that_is_no_yaml(write, content):
    path = write(content, "secret.yaml")
    with pytest.raises(SpecError) as caught:
        load(write(with_file("secret.yaml")))
    (problem,) = caught.value.problems
    assert SECRET not in str(problem)
    assert (problem.file, problem.what) == (str(path), "not YAML")


def test_a_plant_file_stands_below_the_folder_of_its_spec(write, tmp_path):
    write(PLANT_FILE, "outside.yaml")
    below = "a plant's file stands below the folder of its spec"
    (tmp_path / "specs" / "deep").mkdir(parents=True)
    for name in (
        "../outside.yaml",
        str(tmp_path / "outside.yaml"),
        "deep/../../outside.yaml",
        "deep/../in.yaml",
        "/etc/passwd",
        "/dev/zero",
    ):
        assert refused_plant(write, tmp_path, name).startswith(below)
    for link, target in (("out.yaml", "../outside.yaml"), ("etc.yaml", "/etc/passwd"), ("zero.yaml", "/dev/zero")):
        os.symlink(target, tmp_path / "specs" / link)
        assert refused_plant(write, tmp_path, link).startswith(below)
    os.symlink("..", tmp_path / "specs" / "up")
    assert refused_plant(write, tmp_path, "up/outside.yaml").startswith(below)
    os.symlink("loop.yaml", tmp_path / "specs" / "loop.yaml")
    assert refused_plant(write, tmp_path, "loop.yaml").startswith("the file cannot be read")
    # A link that stays below is as good as a file.
    write(PLANT_FILE, "specs/deep/in.yaml")
    os.symlink("deep/in.yaml", tmp_path / "specs" / "here.yaml")
    for name in ("here.yaml", "deep/in.yaml"):
        load(write(with_file(name), "specs/spec.yaml"))


def test_what_is_no_file_is_refused_at_once(write, tmp_path):
    (tmp_path / "specs" / "folder.yaml").mkdir(parents=True)
    os.mkfifo(tmp_path / "specs" / "pipe.yaml")
    write("a: " + "x" * 300_000, "specs/huge.yaml")
    told = [refused_plant(write, tmp_path, f"{name}.yaml").split(";")[0] for name in ("folder", "pipe", "huge")]
    assert told == ["a YAML file is expected", "a YAML file is expected", "the file is too large"]
    assert refused_plant(write, tmp_path, "notes.txt").startswith("a plant's file is a YAML file")
    assert refused_plant(write, tmp_path, r'"x\0.yaml"').startswith("the file cannot be read")


def test_reading_a_spec_stays_light(write):
    path = write(PENDULUM)
    heavy = ("numpy", "scipy", "flint", "matplotlib", "cvxpy", "clarabel", "sympy")
    code = f"import sys; from cdobs_cli.spec.model import load; load({str(path)!r}); print([m for m in {heavy} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
