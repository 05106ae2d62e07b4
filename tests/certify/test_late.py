"""Errors while measurements are under way: no word of samples, delays, slopes and signals passes what is proved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import made
from example_inclusions import plant
from scipy.linalg import expm

from cdobs_cli.certify import late as module
from cdobs_cli.certify.late import Late, NoBoundError, late_error
from cdobs_cli.delays import Delay
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.hybrid import HybridInclusion, PlantView
from cdobs_cli.plant import Box, Plant
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import Sensor

CARDS: dict[str, Any] = {"K": Reachability(), "L": LpvZeroOrderHold()}
Array = np.ndarray[Any, Any]


def delay(low: str, high: str, name: str = "", outputs: tuple[int, ...] = (0,)) -> Delay:
    return Delay(name, outputs, Exact(low), Exact(high))


def box(*sizes: str) -> Box:
    ends = tuple(map(Exact, sizes))
    return Box(tuple(-end for end in ends), ends)


def swing(law: SamplingLaw, *delays: Delay, slope: tuple[str, str] = ("-1", "1"), C: Any = ((1, 0),)) -> Plant:
    """xdot = (x2, V x1 - 0.3 x2) + d, V in an interval."""
    low, high = ([[0, 0], [end, 0]] for end in slope)
    made = plant([[0, 1], [0, "-0.3"]], low, high, C, law)
    return replace(
        made, delays=delays, noise=box(*["0.1"] * len(C)), disturbance=box("0", "0.2"),
    )  # fmt: skip


def two_sensors(*delays: Delay) -> Plant:
    law = SamplingLaw.multirate(Exact("0.4"), [Sensor("a", (0,), Fraction(2)), Sensor("b", (1,), Fraction(1))], "one")
    return swing(law, *delays, C=((1, 0), (0, 1)))


@dataclass
class Loop:
    """The error system in floats, apart from how it is bounded."""

    plant: Plant
    letter: str
    gains: list[Array]

    def maps(self, K: Array) -> Any:
        return CARDS[self.letter].late_maps(replace(PlantView.floats(self.plant, {}), gain={self.letter: K}))

    def jump(self, q: int, there: list[int]) -> tuple[Array, Array]:
        K = self.gains[q].copy()
        K[:, [k for k in range(self.plant.p) if k not in there]] = 0
        errors, acting = self.maps(K)
        size = errors.base.shape[0]
        return (np.array(errors.jump), np.array(acting.kick)) if there else (np.eye(size), 0 * np.array(acting.kick))


def inclusion_of(made: Plant, letter: str, gain: Any) -> HybridInclusion:
    return CARDS[letter].inclusion(made, {letter: ExactMatrix(gain)})


def loop_of(inclusion: HybridInclusion, letter: str) -> Loop:
    law = inclusion.sampling
    own = inclusion.phase_gains if law.is_multirate else [inclusion.gain]
    return Loop(inclusion.plant, letter, [np.array(one[letter].floats) for one in own])


def late_of(inclusion: HybridInclusion, letter: str, norm: Any = "size") -> Late:
    return late_error(inclusion, CARDS[letter].late_maps, norm)


def worst(loop: Loop, b: Array, rng: np.random.Generator, words: int) -> Array:
    """The largest |e(t)| met over random delays, times, slopes and the worst signals and errors within b before the
    first stamp of which a sample is missing."""
    made, law = loop.plant, loop.plant.sampling
    most, n = b.copy(), made.n
    v0, d0 = (np.array(one.float_sizes) for one in (made.noise, made.disturbance))
    corners = [np.array(A) for A in loop.maps(loop.gains[0])[0].corners()]
    B = np.array(loop.maps(loop.gains[0])[1].drive)
    gaps = [float(gap) for gap in law.gaps] or [float(law.T_max)]
    reads = [list(phase.outputs) for phase in law.phases] or [list(range(made.p))]
    by_output = {k: one for one in made.delays for k in one.outputs}
    for _ in range(words):
        stamps, t, q = [], 0.0, int(rng.integers(len(gaps)))
        for _ in range(14):
            gap = gaps[q] if law.is_periodic or law.is_multirate else rng.choice([float(law.T_min), float(law.T_max)])
            d = {k: _drawn(by_output[k], rng) for k in reads[q]}
            if law.is_lossy and rng.random() < 0.3:
                d = {}
            stamps.append((t, q, {k: t + one for k, one in d.items()}))
            t, q = t + (float(law.T_min) if law.is_lossy else gap), (q + 1) % len(gaps)
        far = max(float(one.upper) for one in made.delays)
        now = rng.uniform(0, far) if rng.random() < 0.5 else far - 1e-9
        late = [one for one in stamps if one[2] and max(one[2].values()) > now and one[0] <= now]
        if not late:
            continue
        word: list[tuple[Array, Array | None, Array | None]] = []
        first = late[0][0]
        for (at, q, arrivals), after in zip(stamps, [one[0] for one in stamps[1:]] + [t], strict=True):
            if not first <= at <= now:
                continue
            J, G = loop.jump(q, [k for k, one in arrivals.items() if one <= now])
            word.append((J, G, None))
            length, parts = min(after, now) - at, int(rng.integers(1, 4))
            for _ in range(parts):
                M = np.zeros((len(B) + n, len(B) + n))
                M[: len(B), : len(B)], M[: len(B), len(B) :] = corners[rng.integers(len(corners))], B
                X = expm(M * length / parts)
                word.append((X[: len(B), : len(B)], None, X[: len(B), len(B) :]))
        start = b if len(B) == n else np.concatenate([b, np.abs(np.array(made.C.floats)) @ b + v0])
        for i in range(n):
            p, total = np.eye(len(B))[i], 0.0
            for F, G, D in reversed(word):
                total += 0.0 if G is None else np.abs(p @ G) @ v0
                total += 0.0 if D is None else np.abs(p @ D) @ d0
                p = p @ F
            most[i] = max(most[i], total + np.abs(p) @ start)
    return most


def _drawn(one: Delay, rng: np.random.Generator) -> float:
    low, high = float(one.lower), float(one.upper)
    return float(rng.choice([low, high, rng.uniform(low, high)]))


PERIODIC = SamplingLaw.periodic(Exact("0.4"))
LOSSY, VARYING = SamplingLaw.periodic(Exact("0.4"), 2), SamplingLaw("aperiodic", Exact("0.3"), Exact("0.5"))


def jumping(law: SamplingLaw, low: str, high: str, **further: Any) -> HybridInclusion:
    return inclusion_of(swing(law, delay(low, high), **further), "K", [["0.8"], ["0.9"]])


def sensed(first: tuple[str, str], second: tuple[str, str]) -> HybridInclusion:
    made = two_sensors(delay(*first, "a"), delay(*second, "b", (1,)))
    return inclusion_of(made, "K", [["0.5", "0.1", "0.1"], ["0.2", "0.4", "0.4"]])


# Which share of the bound is met at least.
CASES: list[tuple[str, HybridInclusion, str, float]] = [
    ("shorter than a period", jumping(PERIODIC, "0", "0.2"), "K", 0.95),
    ("constant", jumping(PERIODIC, "0.9", "0.9"), "K", 0.85),
    ("overtaking", jumping(PERIODIC, "0.1", "1"), "K", 0.7),
    ("lossy", jumping(LOSSY, "0", "0.7"), "K", 0.7),
    ("varying", jumping(VARYING, "0.2", "0.4"), "K", 0.85),
    ("linear", jumping(PERIODIC, "0", "1", slope=("-1", "-1")), "K", 0.9),
    ("held", inclusion_of(swing(PERIODIC, delay("0", "0.3")), "L", [["0.8"], ["0.9"]]), "L", 0.9),
    ("laboratory", sensed(("0.5", "0.5"), ("0", "0")), "K", 0.85),
    ("two late", sensed(("0.3", "0.5"), ("0", "0.6")), "K", 0.6),
]


@pytest.mark.parametrize(("inclusion", "letter", "near"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_no_word_passes_the_bound_and_some_come_near(inclusion: HybridInclusion, letter: str, near: float) -> None:
    rng = np.random.default_rng(3)
    b = np.array([0.5, 0.8])
    found = [float(one) for one in late_of(inclusion, letter).errors([Exact(str(one)).ball() for one in b])]
    met = worst(loop_of(inclusion, letter), b, rng, 600)
    assert np.all(met <= np.array(found) * (1 + 1e-9))
    assert np.all(met >= near * np.array(found)), met / np.array(found)


@pytest.mark.parametrize("inclusion", [CASES[2][1], CASES[8][1]], ids=["overtaking", "two late"])
def test_noise_of_all_that_has_overtaken_counts(inclusion: HybridInclusion) -> None:
    b = np.array([1e-6, 1e-6])
    quiet = replace(inclusion, plant=replace(inclusion.plant, disturbance=box("0", "0")))
    found = np.array([float(one) for one in late_of(quiet, "K").errors([Exact("1e-6").ball()] * 2)])
    met = worst(loop_of(quiet, "K"), b, np.random.default_rng(5), 1500)
    assert np.all(met <= found * (1 + 1e-9)) and np.all(met >= 0.8 * found), met / found


def test_short_delays_cost_in_proportion() -> None:
    """|e| grows at most by what its rate, with |x1|, |x2| <= 1, comes to: 1 + 0.1 K v, 1 + 1 - 0.3 + 0.2."""
    costs = []
    for d in ("0.02", "0.01", "0.005"):
        late = late_of(jumping(PERIODIC, d, d), "K")
        costs.append([(float(one) - 1) / float(d) for one in late.errors([Exact("1").ball()] * 2)])
    assert np.allclose(costs[-1], [1.0, 1.0 + 0.2 - 0.3], atol=0.35)
    assert np.allclose(costs[-1], costs[-2], rtol=0.05)


def test_a_longer_delay_is_never_better() -> None:
    b = [Exact("1").ball()] * 2
    found = [late_of(jumping(PERIODIC, "0", d), "K").errors(b) for d in ("0.1", "0.3", "0.5", "0.9")]
    sizes = [np.array(one, dtype=float) for one in found]
    assert all(np.all(more >= 0.999 * less) for less, more in pairwise(sizes))


def test_the_factor_of_decay_holds_for_every_word() -> None:
    for _, inclusion, letter, _ in CASES:
        free = replace(inclusion.plant, noise=box(*["0"] * inclusion.plant.p), disturbance=box("0", "0"))
        quiet = replace(inclusion, plant=free)
        g = float(late_of(quiet, letter).growth)
        met = [worst(loop_of(quiet, letter), b, np.random.default_rng(1), 100) for b in np.eye(2)]
        assert g >= 1 and max(map(np.max, met)) <= g * (1 + 1e-9)
    assert float(late_of(jumping(PERIODIC, "1e-6", "1e-6"), "K").growth) < 1.00001


def white(made: Plant) -> Plant:
    quiet = replace(made, noise=None, disturbance=None)
    return replace(quiet, covariance=ExactMatrix([["0.01"]]), intensity=ExactMatrix([[0, 0], [0, "0.04"]]))


def test_mean_squares_hold_the_covariance_of_a_linear_loop() -> None:
    made = white(swing(PERIODIC, delay("0", "0.3"), slope=("-1", "-1")))
    late = late_of(inclusion_of(made, "K", [["0.8"], ["0.9"]]), "K", "mean square")
    A, S0 = np.array([[0, 1], [-1, -0.3]]), np.diag([0.25, 0.64])
    found = np.array([float(one) for one in late.errors([Exact("0.5").ball(), Exact("0.8").ball()])])
    most = np.zeros(2)
    for r in np.linspace(0, 0.3, 31):
        F = expm(A * r)
        grid = np.linspace(0, r, 200)
        white_part = np.trapezoid([expm(A * s) @ np.diag([0, 0.04]) @ expm(A * s).T for s in grid], grid, axis=0)
        for rho in (-1.0, 0.0, 1.0):
            S = S0 + rho * np.array([[0, 0.4], [0.4, 0]])
            most = np.maximum(most, np.sqrt(np.diag(F @ S @ F.T + white_part)))
    assert np.all(most <= found) and np.all(most >= 0.7 * found)


def test_what_cannot_be_followed_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    inclusion = jumping(PERIODIC, "0", "9")
    with pytest.raises(NoBoundError, match="more samples than are followed"):
        late_of(inclusion, "K").errors([Exact("1").ball()] * 2)
    monkeypatch.setattr(module, "MAX_FLOWS", 1)
    with pytest.raises(NoBoundError):
        late_of(CASES[2][1], "K").errors([Exact("1").ball()] * 2)


PENDULUM = """\
spec_version: 1
plant:
  states: [theta, omega]
  A: [[0, 1], [0, 0]]
  phi: ["0", "-sin(theta)"]
  lipschitz: [[0, 0], [1, 0]]
  disturbance: {lower: [0, -0.2], upper: [0, 0.2]}
measurement: {C: [[1, 0]], sampling: {period: 0.3}, delay: [0, 0.7], noise: {lower: [-0.1], upper: [0.1]}}
observer: {family: FAMILY, gain: {GAIN}}
simulation:
  horizon: 20
  initial_box: {lower: [-0.2, -0.2], upper: [0.2, 0.2]}
  runs: 6
  delays: DELAYS
  signals: {d: ["0", "0.2*tanh(50*sin(W*t))"], v: ["0.1*tanh(50*sin(W*t + F))"]}
"""


@pytest.mark.parametrize(
    ("family", "gain", "delays"),
    [("reachability", "K: [[0.7], [0.6]]", "latest"), ("lpv_zoh", "L: [[3.11], [3.27]]", "random")],
    ids=["jumps", "held"],
)
def test_no_run_passes_what_is_proved(tmp_path: Path, family: str, gain: str, delays: str) -> None:
    text = PENDULUM.replace("FAMILY", family).replace("GAIN", gain).replace("DELAYS", delays)
    check: dict[str, Any] = {}
    largest: dict[str, float] = {}
    for W, F in (("0.9", "0"), ("1.2", "3.1"), ("2.5", "1.5"), ("10.4", "0")):
        stages = ("synthesize", "check", "simulate")
        done = made(tmp_path, text.replace("W", W).replace("F)", f"{F})"), stages)
        assert done.check is not None and done.simulation is not None
        assert [str(one) for one in done.messages if one.severity == "error"] == []
        check = done.check
        for state, size in done.simulation["overall"]["error_max"].items():
            largest[state] = max(largest.get(state, 0.0), size)
    bounds = {state: float(check["bounds"][f"error_transient.{state}"]["proved"]) for state in largest}
    assert check["verdict"] == "proved"
    assert all(0.2 * bounds[state] < size <= bounds[state] for state, size in largest.items()), (largest, bounds)


DOMAIN = """\
spec_version: 1
plant:
  states: [theta, omega]
  dynamics: ["omega", "-theta**3 - 0.4*omega - 0.5*theta"]
  output: [theta]
  domain: {theta: [-1.2, 1.2], omega: [-2, 2]}
measurement: {sampling: {period: 0.2}, delay: DELAY, noise: {lower: [-0.01], upper: [0.01]}}
observer: {family: reachability, saturate: false}
simulation: {horizon: 1, initial_state: [0.8, 0], initial_estimate: [0.75, 0]}
"""


def test_a_margin_of_the_domain_counts_what_is_under_way(tmp_path: Path) -> None:
    """Without the delay a smaller one would do; with it, that one is not enough."""
    margins = []
    for late in ("0", "0.3"):
        done = made(tmp_path, DOMAIN.replace("DELAY", late), ("synthesize", "check"))
        assert done.design is not None and done.check is not None and done.check["verdict"] == "proved"
        estimate, bounds = done.design["estimate"], done.check["bounds"]
        assert estimate["way"] == "margin"
        margins.append({state: float(size) for state, size in estimate["margin"].items()})
        assert all(float(bounds[f"error_transient.{one}"]["proved"]) <= size for one, size in margins[-1].items())
    assert all(margins[1][state] > 1.1 * margins[0][state] for state in ("theta", "omega"))


WHOLE = """\
spec_version: 1
plant:
  states: [a, b]
  A: [[0.5, 1], [-1, 0.5]]
  phi: ["0", "0.1*sin(a)"]
  lipschitz: [[0, 0], [[-0.1, 0.1], 0]]
measurement: {C: [[1, 0], [0, 1]], sampling: {period: 0.5}, delay: [0, 0.4]}
observer: {family: reachability, gain: {K: [[0.99, 0], [0, 0.99]]}}
simulation: {horizon: 2, initial_state: [1, 1], initial_estimate: [0, 0], delays: latest}
"""


def test_until_the_first_sample_is_there_the_error_is_what_it_was(tmp_path: Path) -> None:
    """Samples that tell nearly all leave little of an error, 0.03 of it without delay, once the first one is there."""
    done = made(tmp_path, WHOLE, ("synthesize", "check", "simulate"))
    assert done.check is not None and done.simulation is not None
    largest = max(done.simulation["overall"]["error_max"].values())
    assert 1 <= largest <= float(done.check["envelope"]["factor"]) * np.hypot(1, 1)
