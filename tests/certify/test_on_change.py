"""Sensors that send on change: the law, certificates against other simulations, gains, and what is not proved."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from example_inclusions import plant
from scipy.linalg import expm

from cdobs_cli.certify.accuracy import by_state, sized
from cdobs_cli.certify.falsify import refute
from cdobs_cli.certify.judge import judge
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.named import loaded
from cdobs_cli.certify.methods.on_change.certificate import OnChange, OnChangePeak
from cdobs_cli.certify.methods.on_change.design import design
from cdobs_cli.certify.methods.on_change.form import drop
from cdobs_cli.certify.methods.rung import GENERAL
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.plant import Box, Plant
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.thresholds import Threshold

ONE = Exact(1)


def law(*deltas: Any, every: Any = None) -> SamplingLaw:
    thresholds = [Threshold(f"s{k}", k, Exact(delta)) for k, delta in enumerate(deltas)]
    return SamplingLaw.on_change(thresholds, None if every is None else Exact(every))


def box(*sizes: Any) -> Box:
    return Box(tuple(-Exact(one) for one in sizes), tuple(Exact(one) for one in sizes))


def pendulum(sampling: SamplingLaw, **further: Any) -> Plant:
    made = plant([[0, 1], [0, 0]], [[0, 0], [-1, 0]], [[0, 0], [1, 0]], [[1, 0]], sampling)
    return replace(made, **further)


def chain(sampling: SamplingLaw, C: Any, **further: Any) -> Plant:
    A, zero = [[0, 1, 0], [0, 0, 1], [0, 0, 0]], [[0, 0, 0], [0, 0, 0]]
    made = plant(A, [*zero, [-1, "-0.5", 0]], [*zero, [1, "0.5", 0]], C, sampling)
    return replace(made, **further)


def oscillator(sampling: SamplingLaw, **further: Any) -> Plant:
    made = plant([["0.5", "0.6"], ["-0.6", "0.4"]], [[0, 0], ["-0.3", 0]], [[0, 0], ["0.3", 0]], [[1, 0]], sampling)
    return replace(made, **further)


def asked(about: Plant, K: Any = None, effort: int = 1, **card: Any) -> Question:
    gain = {} if K is None else {"K": K if isinstance(K, ExactMatrix) else ExactMatrix(K)}
    return Reachability(**card).question(about, gain, effort)


def designed(about: Plant, effort: int = 1, **card: Any) -> Question:
    """With the gain that is found."""
    met = design(asked(about, effort=effort, **card))
    assert met is not None
    return asked(about, met[0], effort, **card)


def errors(question: Question) -> dict[str, float]:
    return {name: float(error) for name, error in by_state(sized(question)).items()}


# ---------------------------------------------------------------- the law


def test_what_the_law_holds() -> None:
    one = law("0.05", "1/3")
    assert one.words == "on change, s0 beyond 0.05, s1 beyond 1/3" and one.is_on_change and not one.is_checked
    assert SamplingLaw.from_document(one.document()) == one
    checked = law("0.05", every="0.01")
    assert checked.words == "on change, s0 beyond 0.05, compared every 0.01" and checked.is_checked
    assert SamplingLaw.from_document(checked.document()) == checked != law("0.05")
    assert checked.text("s").endswith("compared every 0.01 s")
    for known in (one, checked):
        assert not (known.is_periodic or known.is_bounded or known.is_multirate or known.from_zero or known.multiples)
        assert known.with_period(ONE) == known and known.contains(known)
        others = [SamplingLaw.periodic(Exact("0.01")), SamplingLaw("aperiodic", Exact(0), ONE), law("0.06")]
        assert not any(known.contains(other) or other.contains(known) for other in others)
        assert not known.allows(Exact("0.01")) and known.unread(2) == [] and known.gain_columns(2) == 2


@pytest.mark.parametrize("entries", [
    [], "radar", [{"name": "a", "delta": "0"}], [{"name": "a", "delta": "-1"}], [{"name": "a"}],
    [{"name": 1, "delta": "1"}], [{"name": "a", "delta": "1", "more": 1}], [{"name": "a", "delta": "1"}] * 2,
])  # fmt: skip
def test_documents_of_no_law(entries: Any) -> None:
    with pytest.raises((ValueError, TypeError, KeyError)):
        SamplingLaw.from_document({"on_change": entries})


def test_a_time_between_comparisons_is_positive() -> None:
    for every in ("0", "-1"):
        with pytest.raises(ValueError, match="no sampling law"):
            SamplingLaw.from_document({"on_change": [{"name": "a", "delta": "1"}], "check_every": every})


# ---------------------------------------------------------------- figures


def test_the_pendulum() -> None:
    """2.61 delta by e'Pe alone; that |e_1| <= delta between messages is used once more."""
    question = designed(pendulum(law(1)), weights={"x1": ONE})
    found = errors(question)
    assert found["x0"] <= 1.0001 and 2.4142 <= found["x1"] <= 2.4147
    given = errors(asked(pendulum(law(1)), [["1"], ["0.736"]]))
    assert given["x1"] <= 2.43


@pytest.mark.parametrize(("every", "most"), [("0.01", 2.43), ("0.1", 2.53), ("0.3", 2.82)])
def test_the_pendulum_compared_at_times(every: str, most: float) -> None:
    assert errors(designed(pendulum(law(1, every=every)), weights={"x1": ONE}))["x1"] <= most


@pytest.mark.parametrize("delta", ["1e-6", "1e6", "sqrt(2)"])
def test_errors_go_with_the_threshold(delta: str) -> None:
    found = errors(designed(pendulum(law(delta)), weights={"x1": ONE}))
    assert found["x1"] == pytest.approx(2.41422 * float(Exact(delta)), rel=1e-3)


def test_errors_of_other_units() -> None:
    """Angles in thousandths, time in minutes."""
    A, lower, upper = [[0, "60/1000"], [0, 0]], [[0, 0], ["-60000", 0]], [[0, 0], ["60000", 0]]
    scaled = errors(designed(plant(A, lower, upper, [[1, 0]], law("0.001")), weights={"x1": ONE}))
    assert scaled["x1"] == pytest.approx(2.41422, rel=1e-3)


# ---------------------------------------------------------------- simulations


def worst(question: Question, seed: int, *, length: float = 24.0, steps: int = 3600) -> np.ndarray[Any, Any]:
    """The largest |e| over the second half of runs against slopes and signals that do their worst, from e(0) = 0 and
    from far away: bang-bang by what drives one state on, at random, and both in turn."""
    about, K = question.plant, question.gain("K").floats
    C, sampling, rng = about.C.floats, about.sampling, np.random.default_rng(seed)
    delta = np.array([float(one.delta) for one in sampling.thresholds])
    vbar = np.zeros(about.p) if about.noise is None else np.array([float(one) for one in about.noise.upper])
    dbar = np.zeros(about.n) if about.disturbance is None else np.array([float(x) for x in about.disturbance.upper])
    corners = list(question.inclusion.floats.corners())
    dt = length / steps
    each = max(1, round(float(sampling.T_max) / dt)) if sampling.is_checked else 1
    if sampling.is_checked:
        dt = float(sampling.T_max) / each
    n, largest = about.n, np.zeros(about.n)
    signals = [
        np.array(one) for one in np.stack(np.meshgrid(*[[-x, x] if x else [0.0] for x in dbar]), -1).reshape(-1, n)
    ]
    block = [[_step(A, d, dt) for d in signals] for A in corners]
    for aim in range(n):
        for kind in ("drive", "random", "both"):
            e = rng.normal(size=n) * (100.0 * delta.max() if kind == "both" else 0.0)
            v = rng.uniform(-vbar, vbar)
            choice = (0, 0)
            for k in range(int(length / dt)):
                if kind == "drive" or (kind == "both" and (k // 200) % 2):
                    sign = 1.0 if e[aim] >= 0 else -1.0
                    rates = [[sign * (block[i][j][0] @ e + block[i][j][1])[aim] for j in range(len(signals))]
                             for i in range(len(corners))]  # fmt: skip
                    choice = tuple(np.unravel_index(int(np.argmax(rates)), (len(corners), len(signals))))  # type: ignore[assignment]
                elif k % 40 == 0:
                    choice = (int(rng.integers(len(corners))), int(rng.integers(len(signals))))
                F, g = block[choice[0]][choice[1]]
                e = F @ e + g
                if k > length / dt / 2:
                    largest = np.maximum(largest, np.abs(e))
                if (k + 1) % each:
                    continue
                if sampling.is_checked:
                    v = vbar * rng.choice([-1.0, 1.0], about.p)
                for _ in range(200):
                    r = v - C @ e
                    i = int(np.argmax(np.abs(r) / delta))
                    if abs(r[i]) < delta[i]:
                        break
                    e = e + K[:, i] * r[i]
                    if not sampling.is_checked:
                        v = vbar * rng.choice([-1.0, 1.0], about.p)
                if k > length / dt / 2:
                    largest = np.maximum(largest, np.abs(e))
    return largest


def _step(A: Any, d: Any, dt: float) -> tuple[Any, Any]:
    """(F, g) of e -> F e + g over dt of edot = A e + d."""
    n = len(A)
    M = np.zeros((n + 1, n + 1))
    M[:n, :n], M[:n, n] = A, d
    E = expm(M * dt)
    return E[:n, :n], E[:n, n]


def cases() -> Iterator[tuple[str, Plant]]:
    two = [[1, 0, 0], [0, 1, 0]]
    yield "pendulum", pendulum(law(1))
    yield "pendulum, noise", pendulum(law("0.1"), noise=box("0.04"), disturbance=box(0, "0.1"))
    yield "pendulum, checked", pendulum(law(1, every="0.3"))
    yield "pendulum, noise, checked", pendulum(law("0.1", every="0.1"), noise=box("0.03"), disturbance=box(0, "0.1"))
    yield "oscillator", oscillator(law("0.2"))
    yield "oscillator, checked", oscillator(law("0.2", every="0.5"), disturbance=box("0.05", 0))
    yield "chain", chain(law("0.1"), [[1, 0, 0]])
    yield "two sensors", chain(law("0.1", "0.3"), two, noise=box("0.01", "0.02"), disturbance=box(0, 0, "0.2"))
    yield "two sensors, checked", chain(law("0.1", "0.3", every="0.1"), two)
    yield "skew outputs", chain(law("0.1", "0.3"), [[1, "1/3", 0], ["-0.2", 0, 2]])


@pytest.mark.parametrize(("name", "about"), list(cases()), ids=[name for name, _ in cases()])
def test_no_run_passes_what_is_proved(name: str, about: Plant) -> None:
    question = designed(about)
    assert OnChange.propose(question) is not None
    found = errors(question)
    assert found.keys() == set(about.states)
    met = worst(question, 7)
    # Events are seen up to a step late.
    slack = 1.0 if about.sampling.is_checked else 1.02
    for state, largest in zip(about.states, met, strict=True):
        assert largest <= slack * found[state], (name, state)
        assert found[state] <= 12 * largest, (name, state)  # and the bound says something


# ---------------------------------------------------------------- proofs


def test_the_jump_keeps_the_kernel_of_its_output() -> None:
    """P K = l C' exactly: a gain that is a digit off has another P, and so has P a digit off."""
    question = designed(pendulum(law(1)))
    method = OnChange.propose(question)
    assert method is not None and method.prove(question).holds
    for i, j in ((0, 1), (1, 0)):
        rows = [list(row) for row in method.P[0]]
        rows[i][j] = str(Exact(rows[i][j]) * Exact("1.0000001"))
        assert not replace(method, P=[rows]).prove(question).holds
    K = question.gain("K")
    other = [[K[0, 0]], [K[1, 0] + Exact("1e-9")]]
    assert not method.prove(asked(question.plant, other)).holds


@pytest.mark.parametrize("every", [None, "0.2"])
def test_every_part_of_the_data_counts(every: str | None) -> None:
    about = pendulum(law(1, every=every), disturbance=box(0, "0.1"), noise=box("0.01"))
    question = designed(about).of_state(1)
    method = OnChangePeak.propose(question)
    assert method is not None
    proof = method.prove(question)
    assert proof.holds and proof.error is not None

    def holds(**changes: Any) -> bool:
        return replace(method, **changes).prove(question).holds

    less = {name: [str(Exact(text) * Exact("0.9")) for text in getattr(method, name)] for name in ("mu", "gamma")}
    assert not any(holds(**{name: texts}) for name, texts in less.items())
    assert not holds(nu=["0"]) or every is not None
    assert not holds(sigma=str(Exact(method.sigma) * Exact("1.1"))) and not holds(sigma="0") and not holds(sigma="-1")
    assert not holds(mu=["-1"]) and not holds(gamma=["-1"]) and not holds(nu=["-1"]) and not holds(state="2")
    assert (
        not holds(mu=[])
        and not holds(gamma=[])
        and not holds(P=[])
        and not holds(N=[])
        and not holds(shape=["0", "0", "0"])
    )
    larger = [[[str(Exact(text) * Exact("1.5")) for text in row] for row in rows] for rows in method.N]
    assert not holds(N=larger)
    if every is not None:
        assert not holds(gamma_N=["0"])
        other = law(1, every="0.25"), law(1), law("0.9", every="0.2")
    else:
        other = law(1, every="0.01"), law("0.9")
    assert not any(holds(law=one) for one in other[:1])
    smaller = replace(method, law=other[-1]).prove(question)
    assert smaller.error is None or smaller.error < proof.error  # of a smaller threshold, where that is one


def test_noise_that_a_message_brings_in() -> None:
    """With a gain that takes all that is seen, noise above half of the threshold may raise V; one that takes less is
    found up to noise of the size of the threshold. Above that nothing is proved, and it is said why."""
    full = designed(pendulum(law("0.1"), noise=box("0.0499"))).gain("K")
    loud = designed(pendulum(law("0.1"), noise=box("0.08")))
    assert float(full[0, 0]) == pytest.approx(0.501) and float(loud.gain("K")[0, 0]) == pytest.approx(0.2)
    found, met = errors(loud), worst(loud, 11)
    assert all(met[k] <= 1.02 * found[f"x{k}"] <= 12 * met[k] for k in range(2))
    whole = [["1"], ["0.7"]]
    assert OnChange.propose(asked(pendulum(law("0.1"), noise=box("0.0499")), whole)) is not None
    for noise in ("0.05", "0.08"):
        assert OnChange.propose(asked(pendulum(law("0.1"), noise=box(noise)), whole)) is None
    for noise in ("0.1", "0.1001", "1"):
        louder = pendulum(law("0.1"), noise=box(noise))
        assert OnChange.propose(asked(louder, whole)) is None and design(asked(louder)) is None
        made = Reachability().synthesize(louder, 1)
        assert made.outcome == "none" and made.reason is not None and "not above its noise" in made.reason
    c, d, v = 0.75, 0.1, 0.06
    assert drop(c, d, v) > 0 > drop(1.0, d, v)
    # By hand: at r = delta, v = vbar, l = 1 the change of V is 2 r C e + r^2 c with C e = v - r.
    assert drop(c, d, v) == pytest.approx(-(2 * d * (v - d) + d * d * c))


@pytest.mark.parametrize("K", [
    [["0"], ["0"]], [["2.1"], ["0.7"]], [["-1"], ["0.7"]], [["1"], ["-0.7"]], [["1"], ["0"]], [["sqrt(1/2)"], ["0.7"]],
])  # fmt: skip
def test_gains_that_are_not_proved(K: Any) -> None:
    question = asked(pendulum(law(1)), K)
    assert OnChange.propose(question) is None and not sized(question)


def test_gains_that_correct_more_or_less_than_all() -> None:
    for first in ("0.5", "1.5"):
        question = asked(pendulum(law(1)), [[first], ["0.7"]])
        found = errors(question)
        met = worst(question, 3)
        assert all(met[k] <= 1.02 * found[f"x{k}"] for k in range(2))


def test_plants_that_no_message_helps() -> None:
    """An unstable mode that the output never shows; and one that decays more slowly than is asked for."""
    A, zero = [["-1", 0], [0, "0.1"]], [[0, 0], [0, 0]]
    hidden = plant(A, zero, zero, [[1, 0]], law(1))
    assert design(asked(hidden)) is None and OnChange.propose(asked(hidden, [["1"], ["0"]])) is None
    card = Reachability()
    made = card.synthesize(hidden, 1)
    assert made.outcome == "none"
    check = judge(card, hidden, made, 1)
    assert check.verdict == "refuted" and not any("inf" in str(bound) for bound in check.bounds.values())
    marginal = plant([["-1", 0], [0, "0"]], zero, zero, [[1, 0]], law(1, every="0.1"))
    assert design(asked(marginal)) is None
    # A constant error of the integrator is seen by nobody: not proved either with a gain that is given.
    assert OnChange.propose(asked(marginal, [["1"], ["0"]])) is None


def test_a_time_between_comparisons_that_is_too_long() -> None:
    question = designed(pendulum(law(1, every="0.1")))
    assert OnChange.propose(asked(pendulum(law(1, every="2.5")), question.gain("K"))) is None


def test_other_methods_keep_off() -> None:
    question = asked(pendulum(law(1, every="0.3")), [["1"], ["0.7"]])
    assert GENERAL.propose(question) is None and refute(question.inclusion, 1) is None
    for method in loaded(GENERAL.methods):
        assert not method.takes_law(question.law)
    assert not OnChange.takes_law(SamplingLaw.periodic(ONE))


def test_levels_hold_on_the_way() -> None:
    """From any start V is at most the larger of what it is at first and of what it is finally."""
    for every in (None, "0.2"):
        about = pendulum(law(1, every=every))
        question = designed(about)
        method = OnChange.propose(question)
        level = None if method is None else method.level(question)
        assert method is not None and level is not None and method.factor(question) is None
        small, large = level.bounds(box("0.001", "0.001")), level.bounds(box(10, 10))
        rng = np.random.default_rng(5)
        C, K, corners = about.C.floats, question.gain("K").floats, list(question.inclusion.floats.corners())
        flows = [expm(A * 0.005) for A in corners]
        for bounds, size in ((small, 0.001), (large, 10.0)):
            for _ in range(20):
                e = size * rng.choice([-1.0, 1.0], 2)
                for k in range(1500):
                    compares = every is None or k % 40 == 0
                    if compares and abs((C @ e)[0]) >= 1:
                        e = e - K[:, 0] * (C @ e)[0]
                    assert all(abs(e[j]) <= 1.02 * float(bounds[j]) for j in range(2))
                    e = flows[int(rng.integers(2)) if k % 50 else 1] @ e


def test_messages_are_counted() -> None:
    question = designed(pendulum(law(1)))
    method = OnChange.propose(question)
    assert method is not None
    first, messages = method.claims(question, method.prove(question))
    assert first.id == "on_change" and messages.id == "messages" and messages.status == "proved"
    often = float(messages.statement.split("at most ")[1].split(" ")[0])
    K, e, count, dt = question.gain("K").floats, np.zeros(2), 0, 0.002
    flow = expm(np.array([[0, 1], [1, 0]]) * dt)
    e[1] = 0.5
    for _ in range(20000):
        e = flow @ e
        if abs(e[0]) >= 1:
            e, count = e - K[:, 0] * e[0], count + 1
    assert 0.02 * often < count / (20000 * dt) <= often


def test_sensors_do_not_undo_what_others_did() -> None:
    """Two sensors that see all of the state: from ten thresholds some messages at one instant leave nothing to send."""
    slopes = [[0, 0], ["-0.35", 0]], [[0, 0], ["0.35", 0]]
    about = plant([["-0.33", 1], ["0.21", "-0.48"]], *slopes, [[1, 0], [0, 1]], law("0.1", "0.1"))
    question = designed(about, effort=0)
    K = question.gain("K").floats
    for angle in np.linspace(0, np.pi, 9):
        e, count = np.array([np.cos(angle), np.sin(angle)]), 0
        while np.abs(e).max() >= 0.1:
            i = int(np.argmax(np.abs(e)))
            e, count = e - K[:, i] * e[i], count + 1
            assert count <= 100


def test_a_digit_of_the_gain_or_of_a_threshold_takes_the_proof_along() -> None:
    card, about = Reachability(), pendulum(law("0.1"), noise=box("0.01"))
    made = card.finished(about, card.synthesize(about, 1), 1)
    check = judge(card, about, made, 1)
    assert check.verdict == "proved" and {"error.x0", "error.x1", "decay_rate"} == check.bounds.keys()
    assert not check.envelope and not made.front
    K = made.gain["K"]
    turned = replace(made, gain={"K": ExactMatrix([[K[0, 0]], [K[1, 0] + Exact("1e-5")]])})
    assert judge(card, about, turned, 1).verdict == "undecided"
    wider = replace(about, sampling=law("0.11"))
    assert judge(card, wider, replace(made, sampling=law("0.11")), 1).verdict == "undecided"
    lower = [replace(one, data={**one.data, "mu": ["0"]}) for one in made.certificates if "mu" in one.data]
    assert judge(card, about, replace(made, certificates=tuple(lower)), 1).verdict == "undecided"


def test_errors_on_the_way_hold_under_noise() -> None:
    card, about = Reachability(), pendulum(law("0.1"), noise=box("0.01"), disturbance=box(0, "0.1"))
    made = card.synthesize(about, 1)
    (noisy,) = card.noisy_transients(about, made)
    (quiet,) = card.transients(about, made)
    assert [float(a) for a in noisy(box(1, 1))] == [float(a) for a in quiet(box(1, 1))]
    finally_ = errors(asked(about, made.gain["K"]))
    assert all(float(a) >= finally_[name] * 0.99 for a, name in zip(noisy(box(0, 0)), about.states, strict=True))
