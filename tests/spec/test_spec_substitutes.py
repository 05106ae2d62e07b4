"""What people write by habit of other tools: one sentence at its place, and what it says to write is accepted."""

# ruff: noqa: E501 - each case stands on one line

from __future__ import annotations

from pathlib import Path

import pytest
from spec_pendulum import PENDULUM, changed

from cdobs_cli.batch import Settings, run
from cdobs_cli.errors import SpecError
from cdobs_cli.exact.units import plain_number
from cdobs_cli.outcome import Job
from cdobs_cli.spec.model import load
from cdobs_cli.spec.reader import read_text

LAW = "sampling: {period: 0.6}"
NOISE = "noise: {lower: [-0.01], upper: [0.01]}"
PHI = "sin(theta)/g"
GAIN = 'gain: {K: [["1"], [1.8361]]}'

# In place of what, what is typed, where the sentence stands, what it says, and what is right (None: nothing to try).
MISTAKES = [
    # When samples come.
    (LAW, "sampling: 0.25", "15:13: measurement.sampling: a mapping is expected; got 0.25", "write sampling: {period: 0.25}", "sampling: {period: 0.25}"),
    (LAW, "sampling: 40 Hz", "15:13: measurement.sampling: a mapping is expected", "write sampling: {period: 0.025}", "sampling: {period: 0.025}"),
    (LAW, "sampling: irregular", "15:13: measurement.sampling: a mapping", "{period: ..}, {min_period: .., max_period: ..} or {updated: true}", None),
    (LAW, "sampling: [0.1, 0.5]", "15:13: measurement.sampling: a mapping", "write sampling: {min_period: 0.1, max_period: 0.5}", "sampling: {min_period: 0.1, max_period: 0.5}"),
    (LAW, "sampling: {period: 0.5, min_period: 0.2, max_period: 0.7}", "15:13: measurement.sampling: one law is expected, these are 2", "write sampling: {period: 0.5}, or sampling: {min_period: 0.2, max_period: 0.7}", "sampling: {min_period: 0.2, max_period: 0.7}"),
    (LAW, "sampling: {updated: true, period: 0.5}", "15:13: measurement.sampling: one law is expected", "or sampling: {updated: true}", None),
    (LAW, "sampling: {frequency: 4}", "15:14: measurement.sampling.frequency: unknown key", "a rate is 1/period: write {period: 0.25}", "sampling: {period: 0.25}"),
    (LAW, "sampling: {fs: 20 Hz}", "15:14: measurement.sampling.fs: unknown key", "write {period: 0.05}", None),
    (LAW, "sampling: {Ts: 250 ms}", "15:14: measurement.sampling.Ts: unknown key", "write {period: 0.25}", None),
    (LAW, "sampling: {dt: 0.3}", "15:14: measurement.sampling.dt: unknown key", "write {period: 0.3}", "sampling: {period: 0.3}"),
    (LAW, "sampling: {sample-time: 0.3}", "15:14: measurement.sampling.sample-time: unknown key", "write {period: 0.3}", None),
    (LAW, "sampling: {MATI: 0.3}", "15:14: measurement.sampling.MATI: unknown key", "write {max_period: 0.3}", "sampling: {max_period: 0.3}"),
    (LAW, "sampling: {period: 0.6, jitter: 0.2}", "15:27: measurement.sampling.jitter: unknown key", "{min_period: 0.4, max_period: 0.8}", "sampling: {min_period: 0.4, max_period: 0.8}"),
    (LAW, "sampling: {period: 0.6, dropouts: 2}", "15:27: measurement.sampling.dropouts: unknown key", "write measurement.lost: {at_most: 2}", f"{LAW}\n  lost: {{at_most: 2}}"),
    (LAW, "sampling: {period: 0.6, packet_loss: 0.1}", "15:27: measurement.sampling.packet_loss: unknown key", "write measurement.lost: {probability: 0.1}", f"{LAW}\n  lost: {{probability: 0.1}}"),
    (LAW, "sampling: {period: 0.6, latency: 50 ms}", "15:27: measurement.sampling.latency: unknown key", "write measurement.delay: 0.05", None),
    (LAW, "sampling: {instants: [0.5, 1.5, 2]}", "15:13: measurement.sampling: a law of all instants", "{min_period: 0.5, max_period: 1}", None),
    (LAW, "sampling: {period:0.6}", "15:14: measurement.sampling.period:0.6: unknown key", "write a space behind the colon: period: 0.6", LAW),
    (LAW, "sampling: {period: 600 ms}", "15:22: measurement.sampling.period: a number without a unit is expected; got \"600 ms\"", "write 0.6: times are in s, the time_unit of the plant", LAW),
    (LAW, "Ts: 0.25", "15:3: measurement.Ts: unknown key", "write sampling: {period: 0.25}", "sampling: {period: 0.25}"),
    (LAW, "sampling_rate: 4", "15:3: measurement.sampling_rate: unknown key", "write sampling: {period: 0.25}", "sampling: {period: 0.25}"),
    (LAW, "period: 0.25", "15:3: measurement.period: unknown key", "write sampling: {period: 0.25}", "sampling: {period: 0.25}"),
    (LAW, f"{LAW}\n  lost: 2", "16:9: measurement.lost: a mapping is expected", "write lost: {at_most: 2}", f"{LAW}\n  lost: {{at_most: 2}}"),
    (LAW, f"{LAW}\n  losses: 0.1", "16:3: measurement.losses: unknown key", "write lost: {probability: 0.1}", f"{LAW}\n  lost: {{probability: 0.1}}"),
    (LAW, f"{LAW}\n  lost: {{in_a_row: 2}}", "16:10: measurement.lost.in_a_row: unknown key", "write {at_most: 2}", f"{LAW}\n  lost: {{at_most: 2}}"),
    # What is measured, and its noise.
    ("C: [[1, 0]]", "C: [0, 1]", "14:6: measurement.C: a matrix is expected: a list of rows, each a list; got [0, 1]", "write C: [[0, 1]]", "C: [[0, 1]]"),
    ("C: [[1, 0]]", "C: [[0], [1]]", "14:6: measurement.C: a matrix of another shape is expected; got 2 x 1; allowed: 1 x 2", "write C: [[0, 1]]", "C: [[0, 1]]"),
    ("C: [[1, 0]]", "H: [[0, 1]]", "14:3: measurement.H: unknown key", "write C: [[0, 1]]", "C: [[0, 1]]"),
    (NOISE, "noise: 0.02", "16:10: measurement.noise: a mapping is expected; got 0.02", "write noise: {lower: [-0.02], upper: [0.02]}, bounds, or noise: {std: [0.02]}, deviations", "noise: {std: [0.02]}"),
    (NOISE, "noise: [[0.02]]", "16:10: measurement.noise: a mapping is expected", "write noise: {covariance: [[0.02]]}", "noise: {covariance: [[0.02]]}"),
    (NOISE, "noise: {std: 0.02}", "16:16: measurement.noise.std: a list is expected; got 0.02", "write std: [0.02]", "noise: {std: [0.02]}"),
    (NOISE, "noise: {covariance: 0.02}", "16:23: measurement.noise.covariance: a matrix is expected", "write covariance: [[0.02]]", "noise: {covariance: [[0.02]]}"),
    (NOISE, "noise: {sigma: 0.02}", "16:11: measurement.noise.sigma: unknown key", "write {std: [0.02]}", "noise: {std: [0.02]}"),
    (NOISE, "noise: {bound: 0.02}", "16:11: measurement.noise.bound: unknown key", "write {lower: [-0.02], upper: [0.02]}", "noise: {lower: [-0.02], upper: [0.02]}"),
    (NOISE, "R: 0.02", "16:3: measurement.R: unknown key", "write noise: {covariance: [[0.02]]}", "noise: {covariance: [[0.02]]}"),
    ('phi: ["0", "sin(theta)/g"]\n  B: [[0], ["1/8"]]\n  lipschitz: [[0, 0], [1, 0]]', 'B: [[0], ["1/8"]]', "4:3: plant.phi: phi and lipschitz are required", 'write phi: ["0", "0"] and lipschitz: [[0, 0], [0, 0]]', 'phi: ["0", "0"]\n  lipschitz: [[0, 0], [0, 0]]'),
    ("C: [[1, 0]]", "H: [0, 1]", "14:3: measurement.H: unknown key", "write C: [[0, 1]]", "C: [[0, 1]]"),
    (GAIN, "K: [1, 2]", "19:3: observer.K: unknown key", "write gain: {K: [[1], [2]]}", "gain: {K: [[1], [2]]}"),
    (NOISE, "R: [[0.02]]", "16:3: measurement.R: unknown key", "write noise: {covariance: [[0.02]]}", "noise: {covariance: [[0.02]]}"),
    # The plant.
    ("disturbance: {lower: [0, -1e-3], upper: [0, .5]}", "Q: [[0, 0], [0, 2]]", "12:3: plant.Q: unknown key", "write disturbance: {intensity: [[0, 0], [0, 2]]}", "disturbance: {intensity: [[0, 0], [0, 2]]}"),
    ("inputs: {u: {range: [-1, 1]}}", "inputs: {u: [-1, 1]}", "5:15: plant.inputs.u: a mapping is expected; got [-1, 1]", "write u: {range: [-1, 1]}", "inputs: {u: {range: [-1, 1]}}"),
    ("inputs: {u: {range: [-1, 1]}}", "inputs: [u]", "5:11: plant.inputs: a mapping is expected", "write inputs: {u: {}}", "inputs: {u: {}}"),
    ("inputs: {u: {range: [-1, 1]}}", "inputs: {u: {bounds: [-1, 1]}}", "5:16: plant.inputs.u.bounds: unknown key; allowed: range", "write {range: [lo, hi]}", None),
    ("theta: [-4, null]", "theta: {min: -4, max: 9}", "11:19: plant.domain.theta: two ends are expected", "write [-4, 9]", "theta: [-4, 9]"),
    ("lipschitz: [[0, 0], [1, 0]]", "lipschitz: [1, 0]", "10:14: plant.lipschitz: a matrix is expected", "write lipschitz: [[1, 0]]", None),
    ("states: [theta, omega]", "state: [theta, omega]", "4:3: plant.state: unknown key", 'write states: ["theta", "omega"]', "states: [theta, omega]"),
    # The observer and the simulation.
    (GAIN, "gain: {L: [[1], [2]]}", "19:10: observer.gain.L: unknown key; allowed: K", "the gain of reachability is K, a jump at samples (an L held from sample to sample is of family lpv_zoh): write gain: {K: [[1], [2]]}", "gain: {K: [[1], [2]]}"),
    (GAIN, "gain: {K: [1, 2]}", "19:13: observer.gain.K: a matrix is expected", "write K: [[1], [2]]", "gain: {K: [[1], [2]]}"),
    (GAIN, "gain: [1, 2]", "19:9: observer.gain: a mapping is expected", "write gain: {K: [[1], [2]]}", "gain: {K: [[1], [2]]}"),
    (GAIN, "K: [[1], [2]]", "19:3: observer.K: unknown key", "write gain: {K: [[1], [2]]}", "gain: {K: [[1], [2]]}"),
    ("family: reachability", "type: reachability", "18:3: observer.type: unknown key", 'write family: "reachability"', 'family: "reachability"'),
    ("horizon: 20", "horizon: 20 min", "21:12: simulation.horizon: a number without a unit is expected", "write 1200", "horizon: 1200"),
    ("horizon: 20", "horizon: 2,5", "21:12: simulation.horizon: a number without a unit", "a decimal point is written '.': 2.5", "horizon: 2.5"),
    ("horizon: 20", "horizon: 2 pi", "21:12: simulation.horizon: not an expression", "a product is written with *: 2*pi", 'horizon: "2*pi"'),
    ("horizon: 20", "tspan: [0, 20]", "21:3: simulation.tspan: unknown key", "write horizon:", None),
    ("horizon: 20", "t_final: 25", "21:3: simulation.t_final: unknown key", "write horizon: 25", "horizon: 25"),
    ("initial_state: [1, 0]", "x0: [2, 0]", "22:3: simulation.x0: unknown key", "write initial_state: [2, 0]", "initial_state: [2, 0]"),
    ("initial_state: [1, 0]", "initial_state: {theta: 1, omega: 0}", "22:18: simulation.initial_state: a list is expected", "without names", None),
    ("runs: 3", "trials: 3", "24:3: simulation.trials: unknown key", "write runs: 3", "runs: 3"),
    ("title: Pendulum", "name: Pendulum", "2:1: name: unknown key", 'write title: "Pendulum"', 'title: "Pendulum"'),
    ("measurement:\n", "mesurement:\n", "13:1: mesurement: unknown key", "did you mean 'measurement'?", "measurement:\n"),
    ("spec_version: 1", "version: 1", "1:1: version: unknown key", "write spec_version: 1", "spec_version: 1"),
    # Expressions.
    (PHI, "0.5*omega^3", "8:14: plant.phi[1]: a power is written **, not ^ (at character 10)", "write 0.5*omega**3", "0.5*omega**3"),
    (PHI, "q*theta", "8:14: plant.phi[1]: unknown name 'q'; known: e, g, k, omega, pi, theta, u", "a constant is declared in plant.parameters: {q: number}, a known input in plant.inputs", None),
    (PHI, "cos(t)", "8:14: plant.phi[1]: unknown name 't'", "plant.inputs, and its signal in simulation.signals", None),
    (PHI, "Omega", "8:14: plant.phi[1]: unknown name 'Omega', did you mean 'omega'?", "known:", "omega"),
    (PHI, "sgn(omega)", "8:14: plant.phi[1]: unknown function 'sgn'", "write tanh(k*x) or sat(k*x)", "sat(k*omega)"),
    (PHI, "np.tanh(omega)", "8:14: plant.phi[1]: unknown function 'np.tanh'", "write tanh", "tanh(omega)"),
    (PHI, "arctan2(omega, theta)", "8:14: plant.phi[1]: unknown function 'arctan2'", "write atan2(y, x)", "atan2(omega, theta + 9)"),
    (PHI, "theta if theta > 1 else 0", "8:14: plant.phi[1]: a choice may jump", "max(x - 1, 0) is x - 1 above 1, else 0", "max(theta - 1, 0)"),
    (PHI, "2 omega", "8:14: plant.phi[1]: not an expression (at character 3)", "a product is written with *: 2*omega", "2*omega"),
    (PHI, "2(omega)", "8:14: plant.phi[1]: a product is written with *", "write 2*(..)", "2*(omega)"),
    (PHI, "k(omega)", "8:14: plant.phi[1]: unknown function 'k'", "a product is written k*(..)", "k*(omega)"),
    (PHI, "sin theta", "8:14: plant.phi[1]: not an expression", "a function is written sin(x)", "sin(theta)"),
    (PHI, "sin", "8:14: plant.phi[1]: unknown name 'sin'", "sin is a function: write sin(x)", "sin(theta)"),
    (PHI, "|omega|", "8:14: plant.phi[1]: not an expression", "an absolute value is written abs(x)", "abs(omega)"),
    (PHI, "omega = 1", "8:14: plant.phi[1]: not an expression", "without =", None),
    (PHI, "omega²", "8:14: plant.phi[1]: an expression is plain ASCII on one line (at character 6)", "write **2 there", "omega**2"),
    (PHI, "sin(theta", "8:14: plant.phi[1]: not an expression", "a ) is missing", "sin(theta)"),
    (PHI, "omega[1]", "8:14: plant.phi[1]: only + - * / **", "called by its name", None),
]  # fmt: skip


def problems(path: Path) -> tuple[str, ...]:
    with pytest.raises(SpecError) as caught:
        load(path)
    return tuple(str(one).removeprefix(f"{path}:") for one in caught.value.problems)


@pytest.mark.parametrize(("old", "typed", "place", "told", "right"), MISTAKES)
def test_a_habit_is_told_once_and_what_is_shown_is_accepted(write, old, typed, place, told, right):
    (problem,) = problems(write(changed((old, typed))))
    assert problem.startswith(place)
    assert told in problem
    assert len(problem) < 500
    if right is not None:
        load(write(changed((old, right))))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ([("  B: [[0]", "  C: [[1, 0]]\n  B: [[0]"), ("  C: [[1, 0]]\n  sampling", "  sampling")], "9:3: plant.C: unknown key"),
        ([("title: Pendulum", f"title: Pendulum\n{LAW}"), (f"  {LAW}\n", "")], "3:1: sampling: unknown key"),
        ([("  B: [[0]", "  initial_state: [1, 0]\n  B: [[0]"), ("  initial_state: [1, 0]\n  initial_estimate", "  initial_estimate")], "9:3: plant.initial_state: unknown key"),
    ],
)  # fmt: skip
def test_a_key_in_another_block_is_told_there_alone(write, changes, told):
    (problem,) = problems(write(changed(*changes)))
    assert problem.startswith(told)


@pytest.mark.parametrize(
    "law", ["sampling: {period: 0.5 h}", "sampling: {rate: 2}\n  lost: 2", "sampling: {Ts: 0.5, h: 1}"]
)
def test_each_of_several_mistakes_is_told_once(write, law):
    told = problems(write(changed((LAW, law), ("horizon: 20", "t_end: 20"), (NOISE, "noise: 0.1"))))
    assert len(set(told)) == len(told)
    assert [one.split(": ")[1].split(".")[0] for one in told].count("simulation") == 1
    assert not any("is required" in one for one in told)


def test_sensors_have_words_of_their_own(write):
    sensors = "sensors: {cam: {H: [[1, 0]], Ts: 0.5, dropouts: 2, R: [[0.1]]}}"
    told = problems(
        write(
            changed(
                ("  C: [[1, 0]]\n", ""), (f"  {NOISE}\n", ""), (LAW, sensors), (', v: ["uniform(-0.01, 0.01)"]', "")
            )
        )
    )
    hints = ["write C: [[1, 0]]", "write period: 0.5", "write lost: {at_most: 2}", "write noise: {covariance: [[0.1]]}"]
    unknown = [one for one in told if "unknown key" in one]
    assert len(unknown) == 4 and all(one.endswith(hint) for one, hint in zip(unknown, hints, strict=True))


@pytest.mark.parametrize(
    ("text", "unit", "told"),
    [
        ("90 s", "min", "write 1.5: times are in min"), ("1.5min", "s", "write 90:"), ("2 d", "h", "write 48:"),
        ("1e-3 s", "ms", "write 1:"), ("50 Hz", "ms", "50 Hz is a period of 20, in ms"), ("3 s", "week", "write a number, in week"),
        ("30 deg", "s", 'write "30*pi/180"'), ("5 mV", "s", "write 5, in the units"), ("12%", "s", "write 0.12"),
        ("0 Hz", "s", "write a number, in s"),
    ],
)  # fmt: skip
def test_a_number_with_a_unit_is_shown_without(text, unit, told):
    found = plain_number(text, unit, ())
    assert found is not None and found.startswith(told)


@pytest.mark.parametrize("text", ["1e-3", "2", "-.5", "1/8", "2*pi", "2 pi", "0x1f", "sqrt(2)", "", "s", "1e5"])
def test_what_has_no_unit_is_left_to_the_language(text):
    assert plain_number(text, "s", ("pi", "e")) is None


# A text that is no YAML, the place, and what to write.
TEXTS = [
    ("title: Tank: two of them\n", "1:12", "a second colon on the line", 'title: "Tank: two of them"'),
    ("title: Tank:\n", "1:12", "a second colon on the line", 'title: "Tank:"'),
    ("plant:\n\tstates: [x]\n", "2:1", "a tab", "two spaces"),
    ("states: [x, y\nA: 1\n", "2:2", "a list that is not closed", "write ]"),
    ("sampling: {period: 1\n", "2:1", "a mapping that is not closed", "write }"),
    ("C: [[1, 0]]]\n", "1:12", "a bracket too many", "once"),
    ('phi: "x\n', "2:1", "a quote that is not closed", "the same quote"),
    ("plant:\n   A: 1\n  C: 2\n", "3:3", "another depth", "the same number of spaces"),
    ("phi: @x\n", "1:6", "begins with a sign", "in quotes"),
    ("expect: - a\n", "1:9", "a list entry on the line of its key", "on the next line"),
    ('phi: "\\q"\n', "1:8", "a backslash in double quotes", "single quotes"),
]


@pytest.mark.parametrize(("text", "place", "what", "hint"), TEXTS)
def test_a_text_that_is_no_yaml_is_told_in_plain_words(text, place, what, hint):
    with pytest.raises(SpecError) as caught:
        read_text(text, "f")
    (problem,) = caught.value.problems
    assert str(problem).startswith(f"f:{place}: ")
    assert problem.what.startswith("not YAML: ") and what in problem.what
    assert problem.hint is not None and hint in problem.hint


@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_a_byte_order_mark_is_read_over(write, loaded, ends):
    text = "\ufeff" + PENDULUM.replace("\n", ends)
    assert load(write(text)).normalised() == loaded().normalised()


def test_places_stand_behind_a_byte_order_mark(write):
    (problem,) = problems(write("\ufeff" + changed(("spec_version: 1", "version: 1"))))
    assert problem.startswith("1:1: version: unknown key")


def test_a_start_outside_the_domain_and_a_signal_outside_its_range(write):
    told = problems(
        write(changed(("initial_state: [1, 0]", "initial_state: [-5, 0]"), ("0.3 + 0.1*sin(t)", "3 + 0.1*sin(t)")))
    )
    assert [one.split(": ")[1] for one in told] == ["simulation.initial_state[0]", "simulation.signals.u"]


def test_an_output_that_cannot_see_a_state_is_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "cart.yaml"
    path.write_text(
        "spec_version: 1\nplant: {states: [p, v], A: [[0, 1], [0, 0]], phi: ['0', '-sin(p)'], lipschitz: [[0, 0], [1, 0]]}\n"
        "measurement: {C: [[0, 1]], sampling: {period: 0.1}}\nobserver: {family: reachability}\n"
    )
    result = run(Job(path, tmp_path / "results"), (), Settings())
    (message,) = result.messages
    assert (result.status, message.severity, message.line) == ("ok", "warning", 3)
    assert "no output sees p" in message.text


# Accepted: nothing is to be written for these.
@pytest.mark.parametrize(
    ("dynamics", "output"),
    [
        ("-9.8*sin(1.3*atan(10*v))", "p"), ("-atan2(v, p)", "p"), ("-log10(v)", "p"), ("-ln(v)", "p"), ("-v**1.852", "p"),
        ("-v + u", "p + p**3 - 0.02*u"), ("-v", "sqrt(p**2 + v**2)"), ("-v", "atan2(v, p)"),
    ],
)  # fmt: skip
def test_what_the_language_takes(write, dynamics, output):
    text = f"""\
spec_version: 1
plant:
  states: [p, v]
  inputs: {{u: {{range: [0, 1]}}}}
  dynamics: ["v", "{dynamics}"]
  output: ["{output}"]
  domain: {{p: [0.5, 2], v: [0.5, 2]}}
measurement: {{sampling: {{period: 0.1}}}}
observer: {{family: reachability}}
"""
    assert load(write(text)).plant.n == 2


@pytest.mark.parametrize(
    "value", ["1/0", "0 Hz", "0", "-1", "1e300", "null", "[]", "{}", "[[]]", "true", '""', "x", "[1, [2]]"]
)
@pytest.mark.parametrize("key", ["rate", "Ts", "jitter", "dropouts", "latency", "times"])
def test_whatever_a_foreign_key_holds_is_refused_in_short(write, key, value):
    told = problems(write(changed((LAW, f"sampling: {{period: 0.5, {key}: {value}}}"))))
    assert 1 <= len(told) <= 2 and all(len(one) < 500 for one in told)
