"""Certificates carried online: the law in every arithmetic, the floor against brute force, errors against what is
proved, and what must not be proved."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from flint import arb
from scipy.integrate import solve_ivp
from updated_plants import burst, chain, last_row, sines

from cdobs_cli.arrays import Array
from cdobs_cli.certificate import Check
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.updated_sampling import UpdatedSampling
from cdobs_cli.families.updated_sampling.carried.exhibits import FLOOR, INTEGRAL, reads, reasons
from cdobs_cli.families.updated_sampling.carried.law import (
    Law,
    after_sample,
    determinant,
    hamiltonian,
    riccati,
    solve,
    strengths,
)
from cdobs_cli.families.updated_sampling.carried.observer import entry_name
from cdobs_cli.families.updated_sampling.carried.proof import floor, least_eigenvalue
from cdobs_cli.families.updated_sampling.carried.slopes import largest_slopes
from cdobs_cli.families.updated_sampling.lipschitz import rate_of
from cdobs_cli.families.updated_sampling.structure import problems
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.plant import Box, Plant
from cdobs_cli.run import SimulationPlan
from cdobs_cli.simulate.engine import simulate

LARGEST = {(1, 0): Fraction(10)}
NOISE = Box((Exact("-0.01"),), (Exact("0.01"),))
PLANT = replace(burst(), noise=NOISE)


def card(**options: object) -> UpdatedSampling:
    return UpdatedSampling.model_validate({"family": "updated_sampling", "method": "carried", **options})


def designed(options: dict[str, object], plant: Plant = PLANT) -> tuple[Design, Check, Law]:
    family = card(**options)
    design = family.synthesize(plant, 0)
    assert design.outcome == "found", design.reason
    return design, family.certify(plant, design, 0), Law.read(design.details["law"])


BUDGETED = {"objective": "min_error", "budget": 5}


@pytest.fixture(scope="module")
def budgeted() -> tuple[Design, Check, Law]:
    return designed(BUDGETED)


def third_order() -> Plant:
    """Slopes on (2, 2) and (3, 1), the first two states measured."""
    slopes = [["0", "0", "0"], ["0", "0.3", "0"], ["2", "0", "0"]]
    plant = chain(3, ["0", "0.3*sin(x2)", "u*sin(x1)"], slopes, {"u": ("0", "2")})
    noise = Box((Exact("-0.01"), Exact("-0.05")), (Exact("0.01"), Exact("0.05")))
    return replace(plant, C=ExactMatrix([[1, 0, 0], [0, 1, 0]]), noise=noise)


# ---------------------------------------------------------------- the law, said once


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_determinant_and_elimination_are_those_of_numpy(n: int) -> None:
    draw = np.random.default_rng(n)
    M = draw.normal(size=(n, n))
    P = M @ M.T + np.eye(n)
    right = draw.normal(size=(n, 2))
    assert determinant(M.tolist()) == pytest.approx(np.linalg.det(M), rel=1e-9)
    np.testing.assert_allclose(solve(P.tolist(), right.tolist(), lambda a, b: a / b), np.linalg.solve(P, right))


def test_the_hamiltonian_matrix_solves_the_riccati_equation() -> None:
    """d/dt Y X^-1 = (Y' - Pi X') X^-1."""
    draw = np.random.default_rng(3)
    A, M = draw.normal(size=(3, 3)), draw.normal(size=(3, 3))
    Pi, gamma = M @ M.T + np.eye(3), [0.1, 0.2, 0.3]
    B, Q = strengths(3, {(1, 0): 2.0, (2, 2): 0.5}, {(1, 0): 3.0, (2, 2): 0.7}, gamma, 0.0)
    assert (B, Q) == ([0.1, 2.2, 0.8], [3.0, 0.0, 0.7])
    H = np.array(hamiltonian(A.tolist(), B, Q, 0.4, 0.0))
    slope = H @ np.vstack([np.eye(3), Pi])
    flow = -Pi @ A - A.T @ Pi - Pi @ np.diag(B) @ Pi - np.diag(Q) - 0.8 * Pi
    np.testing.assert_allclose(slope[3:] - Pi @ slope[:3], flow)
    np.testing.assert_allclose(riccati(Pi.tolist(), A.tolist(), B, Q, 0.8), flow)


def test_the_slopes_are_held_by_the_split() -> None:
    """d/dt e'Pi e <= -2 sigma e'Pi e for every V in its bounds, at random Pi, e and V."""
    draw = np.random.default_rng(4)
    for _ in range(200):
        M, A, e = draw.normal(size=(2, 2)), draw.normal(size=(2, 2)), draw.normal(size=2)
        Pi, c, split = M @ M.T, draw.uniform(0, 5, (2, 2)), np.exp(draw.normal(size=(2, 2)))
        entries = [(i, j) for i in range(2) for j in range(2)]
        cl = {(i, j): c[i, j] * split[i, j] for i, j in entries}
        B, Q = strengths(2, cl, {(i, j): c[i, j] / split[i, j] for i, j in entries}, [0.0, 0.0], 0.0)
        flow = np.array(riccati(Pi.tolist(), A.tolist(), B, Q, 0.6))
        V = c * draw.choice([-1, 1], (2, 2))
        assert e @ flow @ e + 2 * e @ Pi @ (A + V) @ e <= -0.6 * e @ Pi @ e + 1e-9


# ---------------------------------------------------------------- brute force: the rule anew, in numpy and scipy


class Rule:
    """Pi and the instants for a given c(t), from the equations of the note, with scipy's integration."""

    def __init__(self, plant: Plant, law: Law, largest: dict[tuple[int, int], Fraction]) -> None:
        self.A, self.C, self.law = plant.A.floats, plant.C.floats, law
        self.largest = {entry: float(bound) for entry, bound in largest.items()}
        self.F, self.split, self.Lambda = law.F.floats, law.split.floats, np.diag(law.Lambda.floats[0])
        self.T_min, self.theta, self.idle = (float(one) for one in (law.T_min, law.theta, law.idle))

    def gain(self, Pi: Array) -> Array:
        """C'Lambda C of what is read; of one output that with the largest det(Pi + it - F)."""
        if not self.law.one:
            return np.array(self.C.T @ self.Lambda @ self.C)
        each = [weight * np.outer(row, row) for row, weight in zip(self.C, np.diag(self.Lambda), strict=True)]
        return each[int(np.argmax([np.linalg.det(Pi + one - self.F) for one in each]))]

    def slope(self, Pi: Array, c: float) -> Array:
        n = len(Pi)
        total = -Pi @ self.A - self.A.T @ Pi
        share = [min(1.0, c / bound) for bound in self.largest.values()]
        for ((i, j), bound), q in zip(self.largest.items(), share, strict=True):
            now = min(c, bound)
            split = self.split[i, j] * q**-self.theta if now > 0 else self.split[i, j]
            e_i, e_j = np.eye(n)[i], np.eye(n)[j]
            total = total - now * (split * np.outer(Pi @ e_i, Pi @ e_i) + np.outer(e_j, e_j) / split)
        r = max(self.idle, np.sqrt(max(share)))
        return total - 2 * float(self.law.sigma) * r * Pi

    def run(
        self, c: Callable[[float], float], breaks: list[float], horizon: float
    ) -> Iterator[tuple[float, Array, Array]]:
        """(t, Pi before, Pi after) at each sample, and Pi in between as (t, Pi, Pi)."""
        n, t, Pi = len(self.F), 0.0, self.F + self.gain(self.F)
        last = 0.0

        def due(s: float, y: Array) -> float:
            return float(np.linalg.det(y.reshape(n, n) - self.F) / np.linalg.det(self.F) - float(self.law.epsilon))

        due.terminal, due.direction = True, -1  # type: ignore[attr-defined]
        while t < horizon:
            until = min(b for b in (*breaks, last + self.T_min, horizon) if b > t + 1e-12)
            resting = t < last + self.T_min - 1e-9
            middle = (t + until) / 2
            now = c(middle)
            solved = solve_ivp(
                lambda s, y, now=now: self.slope(y.reshape(n, n), now).ravel(), (t, until), Pi.ravel(),
                events=None if resting else due, rtol=1e-9, atol=1e-12, max_step=0.02,
            )  # fmt: skip
            for s, y in zip(solved.t, solved.y.T, strict=True):
                between = y.reshape(n, n)
                yield float(s), between, between
            t, Pi = float(solved.t[-1]), solved.y[:, -1].reshape(n, n)
            if solved.status == 1:
                before = Pi
                Pi = (self.F if self.law.reset else Pi) + self.gain(Pi)
                last = t
                yield t, before, Pi


def _bang_bang(draw: np.random.Generator, most: float, horizon: float) -> tuple[Callable[[float], float], list[float]]:
    """c(t) that jumps between 0 and its bound, and in between, at random times."""
    breaks = sorted(draw.uniform(0, horizon, 24).tolist())
    levels = draw.choice([0.0, 0.02 * most, most, most], 25)
    return lambda t: float(levels[np.searchsorted(breaks, t)]), breaks


# Two outputs, each of which is enough by itself.
TWO = replace(
    burst(), C=ExactMatrix([["1", "0"], ["1", "0.5"]]),
    noise=Box((Exact("-0.01"), Exact("-0.02")), (Exact("0.01"), Exact("0.02"))),
)  # fmt: skip

CASES = {
    "budget": (PLANT, {**BUDGETED, "law": {"idle": "0.2"}}),
    "reset": (PLANT, {**BUDGETED, "reset": True}),
    "longest": (PLANT, {}),
    "third order": (third_order(), {"objective": "min_error", "budget": 4}),
    "one of two": (TWO, {**BUDGETED, "read": "one"}),
}


@pytest.mark.parametrize("case", CASES)
def test_no_switching_of_c_brings_pi_below_its_floor(case: str) -> None:
    plant, options = CASES[case]
    _, check, law = designed(options, plant)
    largest = LARGEST if plant.n == 2 else {(1, 1): Fraction(3, 10), (2, 0): Fraction(2)}
    proved = floor(plant, law, largest)
    assert check.verdict == "proved" and proved.share is not None
    rule, root = Rule(plant, law, largest), np.linalg.inv(np.linalg.cholesky(law.F.floats))
    samples, lowest = [], np.inf
    for seed in range(3):
        c, breaks = _bang_bang(np.random.default_rng(seed), float(max(largest.values())), 5.0)
        last, met = 0.0, []
        for t, before, after in rule.run(c, breaks, 5.0):
            lowest = min(lowest, float(np.linalg.eigvalsh(root @ before @ root.T)[0]))
            if after is not before:
                met.append(t - last)
                last = t
                assert np.linalg.eigvalsh(root @ before @ root.T)[0] >= 1 - 1e-6
        samples += met
    assert lowest >= float(proved.share) and lowest < 1.2
    assert len(samples) > 10 and min(samples) >= float(law.T_min) * (1 - 1e-9)


def test_the_largest_c_alone_asks_soonest_and_close_to_t_min(budgeted: tuple[Design, Check, Law]) -> None:
    """The guaranteed period is not far from what a constant c brings about."""
    _, _, law = budgeted
    rule, last, met = Rule(PLANT, law, LARGEST), 0.0, []
    for t, before, after in rule.run(lambda t: 10.0, [], 4.0):
        if after is not before:
            met.append(t - last)
            last = t
    assert float(law.T_min) <= min(met) <= 1.1 * float(law.T_min)


# ---------------------------------------------------------------- the observer as it is simulated


def _plan(u: str, runs: int = 2, horizon: str = "6", **more: object) -> SimulationPlan:
    from cdobs_cli.exact.parser import parse
    from cdobs_cli.spec.simulation_block import NOISE_FUNCTIONS

    signals = {"u": parse(u, frozenset({"t"})), "v.0": parse("uniform(-0.01, 0.01)", frozenset(), {}, NOISE_FUNCTIONS)}
    box = Box((Exact(-1), Exact(-1)), (Exact(1), Exact(1)))
    return SimulationPlan(Exact(horizon), initial_box=box, runs=runs, seed=1, signals=signals, **more)


@pytest.mark.parametrize("reset", [False, True])
def test_the_simulated_pi_is_that_of_the_note(reset: bool) -> None:
    options = {**BUDGETED, "reset": reset}
    design, _, law = designed(options)
    run = simulate(HybridSystem(PLANT, card(**options).observer(PLANT, design)), _plan("10", 1, "3"), PLANT.sampling)
    first = run.trajectories[0]
    rule = Rule(PLANT, law, LARGEST)
    sampled = [(t, before) for t, before, after in rule.run(lambda t: 10.0, [], 2.5) if after is not before]
    assert len(sampled) >= 8
    for k, (t, before) in enumerate(sampled):
        assert first.t_k[k + 1] == pytest.approx(t, abs=1e-6)
        at = int(np.searchsorted(first.t, first.t_k[k + 1]))
        own = [first.internals[name][at] for name in ("Pi_11", "Pi_12", "Pi_22")]
        np.testing.assert_allclose(own, [before[0, 0], before[0, 1], before[1, 1]], rtol=1e-5)


def test_instants_are_located_to_rounding(budgeted: tuple[Design, Check, Law]) -> None:
    """At a sample det(Pi - F) / det F is epsilon but for rounding, which the difference magnifies."""
    design, _, law = budgeted
    observer = card(**BUDGETED).observer(PLANT, design)
    run = simulate(HybridSystem(PLANT, observer), _plan("5 + 4*sin(3*t)"), PLANT.sampling)
    for trajectory in run.trajectories:
        at = np.searchsorted(trajectory.t, trajectory.t_k[1:], side="left")
        margin = trajectory.internals["margin"][at]
        assert len(at) > 10 and np.all(np.abs(margin) <= 1e-10)
        assert np.diff(trajectory.t_k).min() >= float(law.T_min) * (1 - 1e-12)


@pytest.mark.parametrize("n", [2, 4])
def test_a_floor_that_is_met_in_several_directions_at_once_is_not_missed(n: int) -> None:
    """Equal states that do not touch each other: all eigenvalues of Pi - F pass 0 together, and for an even number of
    them the determinant only touches it."""
    eye, names = np.eye(n, dtype=int), [f"x{i + 1}" for i in range(n)]
    plant = chain(n, [f"u*sin({name})" for name in names], (2 * eye).astype(str).tolist(), {"u": ("0", "2")})
    plant = replace(plant, A=ExactMatrix((eye * Fraction(3, 10)).tolist()), C=ExactMatrix(eye.tolist()))
    typed = {"F": eye, "split": eye, "Lambda": np.full((1, n), 100)}
    rows = {name: matrix.astype(str).tolist() for name, matrix in typed.items()}
    family = card(law={**rows, "sigma": "0.1", "T_min": "0.1", "idle": "1"})
    design = family.synthesize(plant, 0)
    observer = family.observer(plant, design)
    box = Box((Exact(-1),) * n, (Exact(1),) * n)
    plan = replace(_plan("1 + sin(3*t)", 1, "4"), initial_box=box)
    plan = replace(plan, signals={"u": plan.signals["u"]})
    run = simulate(HybridSystem(plant, observer), plan, plant.sampling)
    first = run.trajectories[0]
    assert family.certify(plant, design, 0).verdict == "proved"
    assert len(first.t_k) > 5 and first.t[-1] == 4
    assert first.internals["margin"].min() >= -1.001 * float(Law.read(design.details["law"]).epsilon)
    assert first.internals["Pi_11"].min() >= 1
    # Where Pi - F < 0 in all directions a sample is due still.
    margin = observer.internals["margin"]
    below = {entry_name(i, j): arb(i == j) / 2 for i in range(n) for j in range(i, n)}
    assert margin.ball(below) < 0


def test_the_integral_asks_for_samples_too_and_reasons_are_told() -> None:
    options = {**BUDGETED, "rule": {"trigger": "integral", "kappa": "0.202"}}
    design, check, law = designed(options)
    run = simulate(HybridSystem(PLANT, card(**options).observer(PLANT, design)), _plan("10"), PLANT.sampling)
    told = reasons(law, run.trajectories[0])
    assert check.verdict == "proved" and law.kappa == Exact("0.202")
    assert set(told) <= {FLOOR, INTEGRAL} and INTEGRAL in told
    assert np.diff(run.trajectories[0].t_k).max() <= 0.202 * (1 + 1e-9)


def test_errors_stay_within_what_is_proved(budgeted: tuple[Design, Check, Law]) -> None:
    """Slopes that switch with the sign of the error, noise at its ends against it: never beyond bound or envelope."""
    _, check, law = budgeted
    bounds = [float(check.bounds[f"error.x{i + 1}"].proved or 0) for i in range(2)]
    factor, rate = (float(check.envelope[name]) for name in ("factor", "rate"))
    rule, draw, worst = Rule(PLANT, law, LARGEST), np.random.default_rng(5), np.zeros(2)
    for noisy in (True, False):
        for seed in range(3):
            c, breaks = _bang_bang(np.random.default_rng(seed), 10.0, 8.0)
            e, last = draw.normal(size=2) * 0.01, 0.0
            e_0 = float(np.linalg.norm(e))
            for t, before, after in rule.run(c, breaks, 8.0):
                h, now = t - last, c((t + last) / 2)
                # A secant of either sign, chosen to feed the error.
                V = np.array([[0.0, 1.0], [now * np.sign(e[0] * e[1] * before[1, 1] + 1e-30), 0.0]])
                e = e + h * (V @ (e + h / 2 * V @ e))
                last = t
                if after is not before:
                    K = np.linalg.solve(before + rule.C.T @ rule.Lambda @ rule.C, rule.C.T @ rule.Lambda)[:, 0]
                    v = 0.01 * np.sign(e @ before @ K) if noisy else 0.0
                    e = e - K * e[0] + K * v
                if noisy:
                    worst = np.maximum(worst, np.abs(e))
                    assert np.all(np.abs(e) <= bounds)
                else:
                    assert np.linalg.norm(e) <= factor * e_0 * np.exp(-rate * t) + 1e-12
    assert np.all(worst > 0.2 * np.array(bounds))


@pytest.mark.parametrize(("c", "most"), [("1.2*u", "12"), ("u", "10")])
def test_a_typed_c_beyond_the_slopes_is_cut_to_them(c: str, most: str) -> None:
    """q stays at most 1, and Pi falls no faster than at the declared slopes."""
    from cdobs_cli.exact.parser import parse

    options = {**BUDGETED, "c": parse(c, frozenset({"u"}))}
    design, check, law = designed(options)
    assert design.details["rate"]["largest"] == most and check.verdict == "proved"
    run = simulate(HybridSystem(PLANT, card(**options).observer(PLANT, design)), _plan("10", 1, "2"), PLANT.sampling)
    rule = Rule(PLANT, law, LARGEST)
    sampled = [t for t, before, after in rule.run(lambda t: 10.0, [], 1.5) if after is not before]
    np.testing.assert_allclose(run.trajectories[0].t_k[1 : len(sampled) + 1], sampled, atol=1e-6)


# ---------------------------------------------------------------- what is proved, and its twin that must not be


def test_a_budget_is_kept_and_less_of_it_costs_accuracy(budgeted: tuple[Design, Check, Law]) -> None:
    _, check, law = budgeted
    assert law.T_min == Exact("0.2") and check.bounds["guaranteed_period"].proved == "0.2"
    _, sparse, _ = designed({"objective": "min_error", "budget": "10/3"})
    for state in ("x1", "x2"):
        few, many = (float(one.bounds[f"error.{state}"].proved or 0) for one in (sparse, check))
        assert many < few < 3 * many
    assert float(check.bounds["error.x2"].proved or 1) < 0.145


def test_a_lower_floor_is_proved_too_and_asks_for_fewer_samples() -> None:
    """Where c is small: the same constants but for F, both proved, the lower one with the larger proved error."""
    measured, proved = [], []
    for share in ("1", "0.25"):
        options = {"law": {"T_min": "0.15", "sigma": "0.1", "share": share}}
        design, check, law = designed(options)
        assert check.verdict == "proved" and law.T_min == Exact("0.15")
        run = simulate(HybridSystem(PLANT, card(**options).observer(PLANT, design)), _plan("0.5", 1), PLANT.sampling)
        measured.append(len(run.trajectories[0].t_k))
        proved.append(float(check.bounds["error.x2"].proved or 0))
    assert measured[1] < 0.8 * measured[0] and proved[1] > 1.5 * proved[0]


def test_the_longest_period_passes_what_was_wanted() -> None:
    _, check, _ = designed({})
    assert float(check.bounds["guaranteed_period"].proved or 0) >= 0.39
    _, accurate, _ = designed({"error_at_most": {"x2": "0.25"}})
    assert 0.23 < float(accurate.bounds["error.x2"].proved or 1) <= 0.25
    none = card(error_at_most={"x2": "1e-6"}).synthesize(PLANT, 0)
    assert none.outcome == "none" and "error_at_most" in (none.reason or "")
    assert 0.2 < float(accurate.bounds["guaranteed_period"].proved or 0) < 0.39


@pytest.mark.parametrize(
    "changes",
    [
        {"T_min": Exact("0.24")},
        {"F": ExactMatrix([["9000", "-2600"], ["-2600", "960"]])},
        {"sigma": Exact("1.6")},
        {"split": ExactMatrix([["0", "0"], ["1e-5", "0"]])},
        {"Lambda": ExactMatrix([["2000"]])},
        {"epsilon": Exact("0.5")},
        {"F": ExactMatrix([["1", "2"], ["2", "1"]])},
        {"F": ExactMatrix([["1", "0"], ["0.1", "1"]])},
        {"split": ExactMatrix([["0", "0"], ["0", "0"]])},
        {"theta": Exact(1)},
        {"idle": Exact(2)},
        {"Lambda": ExactMatrix([["0"]])},
        {"gamma": ExactMatrix([["0", "-1"]])},
        {"T_min": Exact(0)},
    ],
)
def test_a_law_that_is_changed_is_not_proved(budgeted: tuple[Design, Check, Law], changes: dict[str, object]) -> None:
    design, _, law = budgeted
    assert floor(PLANT, law, LARGEST).holds
    changed = replace(law, **changes)
    assert not floor(PLANT, changed, LARGEST).holds
    other = replace(design, details={**design.details, "law": changed.document()})
    check = card(objective="min_error", law={"T_min": str(changed.T_min)} if changed.T_min.sign() else {"T_min": 1})
    assert check.certify(PLANT, other, 0).verdict == "undecided"


def test_larger_slopes_are_not_covered(budgeted: tuple[Design, Check, Law]) -> None:
    _, _, law = budgeted
    assert not floor(PLANT, law, {(1, 0): Fraction(12)}).holds
    assert not floor(PLANT, law, {**LARGEST, (1, 1): Fraction(2)}).holds  # no split for it
    assert floor(PLANT, law, {(1, 0): Fraction(5)}).holds


def test_a_law_of_another_spec_is_not_believed(budgeted: tuple[Design, Check, Law]) -> None:
    design, _, _ = budgeted
    for options in ({**BUDGETED, "budget": 6}, {**BUDGETED, "reset": True}, {**BUDGETED, "law": {"sigma": "0.1"}}):
        check = card(**options).certify(PLANT, design, 0)
        assert check.verdict == "undecided" and not check.bounds
    broken = replace(design, details={**design.details, "law": {"F": [["1"]]}})
    assert card(**BUDGETED).certify(PLANT, broken, 0).verdict == "undecided"


def test_what_no_output_sees_has_no_law() -> None:
    plant = replace(PLANT, A=ExactMatrix([[1, 0], [0, 0]]), C=ExactMatrix([[0, 1]]))
    family = card(**BUDGETED)
    design = family.synthesize(plant, 0)
    assert design.outcome == "none" and "no law" in (design.reason or "")
    check = family.certify(plant, design, 0)
    assert check.verdict == "undecided" and {claim.id for claim in check.claims} == {"convergence", "error_bounded"}


def test_a_floor_near_to_singular_stops_no_search() -> None:
    """Nothing is uncertain: at some of the points that are tried F is definite, but not in floats."""
    noise = Box((Exact("-0.0479345"),), (Exact("0.0502498"),))
    plant = replace(chain(2, ["0", "0"], [["0", "0"], ["0", "0"]]), noise=noise)
    plant = replace(plant, A=ExactMatrix([["0", "1"], ["0.537549", "0"]]))
    family = card(law={"share": "0.988673"})
    assert family.certify(plant, family.synthesize(plant, 0), 0).verdict == "proved"


def test_a_whole_law_is_analysed_as_it_is(budgeted: tuple[Design, Check, Law]) -> None:
    _, found, law = budgeted
    typed = {
        name: getattr(law, name).texts() if name in ("F", "split", "Lambda") else str(getattr(law, name))
        for name in ("F", "split", "Lambda", "sigma", "idle", "T_min")
    }
    family = card(law=typed)
    design = family.synthesize(PLANT, 0)
    check = family.certify(PLANT, design, 0)
    assert design.outcome == "given" and family.is_given and check.verdict == "proved"
    assert check.bounds["error.x1"] == found.bounds["error.x1"]
    worse = card(law={**typed, "T_min": "0.24"})
    check = worse.certify(PLANT, worse.synthesize(PLANT, 0), 0)
    assert check.verdict == "undecided" and "shorter T_min" in check.claims[2 + 2].statement


def test_a_disturbance_has_a_weight_of_its_own() -> None:
    plant = replace(PLANT, disturbance=Box((Exact(0), Exact("-0.05")), (Exact(0), Exact("0.05"))))
    design, check, law = designed(BUDGETED, plant)
    assert law.gamma[0, 0].sign() == 0 and law.gamma[0, 1].sign() == 1
    assert check.verdict == "proved" and float(check.bounds["error.x2"].proved or 1) < 0.25
    without = replace(law, gamma=ExactMatrix([["0", "0"]]))
    other = replace(design, details={**design.details, "law": without.document()})
    check = card(**BUDGETED).certify(plant, other, 0)
    assert check.claim("error_bounded").status == "undecided"  # type: ignore[union-attr]


def test_noise_of_a_covariance_has_a_mean_square() -> None:
    plant = replace(PLANT, noise=None, covariance=ExactMatrix([["1e-4"]]))
    _, check, law = designed(BUDGETED, plant)
    low = float(np.linalg.eigvalsh(law.F.floats)[0]) * float(floor(plant, law, LARGEST).share or 0)
    noise = float(law.Lambda[0, 0]) * 1e-4 / float(law.T_min)
    expected = np.sqrt(noise / (2 * float(law.sigma) * float(law.idle) * low))
    assert float(check.bounds["rms"].proved or 0) == pytest.approx(expected, rel=1e-6)
    assert check.verdict == "proved" and "error.x1" not in check.bounds


@pytest.mark.parametrize("disturbed", [False, True])
def test_the_error_is_that_of_the_worst_time_between_samples(disturbed: bool) -> None:
    """max over t of (N exp(-s t) + D) (Pi(t)^-1)_ii, Pi by scipy: not below it, and not far above."""
    box = Box((Exact(0), Exact("-0.05")), (Exact(0), Exact("0.05")))
    plant = replace(PLANT, disturbance=box) if disturbed else PLANT
    _, check, law = designed(BUDGETED, plant)
    s, T = 2 * float(law.sigma) * float(law.idle), float(law.T_min)
    gamma = float(law.gamma[0, 1])
    D = 0.05**2 / gamma / s if disturbed else 0.0
    N = float(law.Lambda[0, 0]) * 0.01**2 / (1 - np.exp(-s * T))
    rule = Rule(plant, law, LARGEST)

    def slope(t: float, y: Array) -> Array:
        Pi = y.reshape(2, 2)
        return (rule.slope(Pi, 10.0) - gamma * np.outer(Pi[:, 1], Pi[:, 1])).ravel()

    first = law.F.floats + rule.C.T @ rule.Lambda @ rule.C
    solved = solve_ivp(slope, (0, T), first.ravel(), rtol=1e-9, t_eval=np.linspace(0, T, 200))
    for i in range(2):
        inverse = np.linalg.inv(solved.y.T.reshape(-1, 2, 2))[:, i, i]
        ahead = (N * np.exp(-s * solved.t) + D) * inverse
        at_floor = (N * np.exp(-s * T) + D) * np.linalg.inv(law.F.floats)[i, i]
        proved = float(check.bounds[f"error.x{i + 1}"].proved or 0) ** 2
        assert max(*ahead, at_floor) <= proved <= 1.05 * max(*ahead, at_floor)


@pytest.mark.parametrize(
    ("plant", "at_least"),
    [
        (chain(1, ["u*sin(x1)"], [["3"]], {"u": ("0", "3")}), 0.4),
        (chain(2, ["0", "0"], [["0", "0"], ["0", "0"]]), 5.0),
        (sines(3), 0.25),
        (last_row(4), 0.9),
        (last_row(6), 0.7),
    ],
    ids=["one state", "no slopes", "three", "four", "six"],
)  # fmt: skip
def test_any_number_of_states_has_a_law(plant: Plant, at_least: float) -> None:
    """The twin: the same law with a T_min that is a quarter longer."""
    _, check, law = designed({}, plant)
    assert check.verdict == "proved" and float(check.bounds["guaranteed_period"].proved or 0) >= at_least
    largest = largest_slopes(plant, rate_of(card(), plant))
    assert largest is not None and floor(plant, law, largest).holds
    assert not floor(plant, replace(law, T_min=Exact(law.T_min.rational * Fraction(5, 4))), largest).holds


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "options",
    [
        {"budget": "1e100"}, {"budget": "1e-100"}, {"law": {"sigma": "1e100"}}, {"law": {"Lambda": [["1e-100"]]}},
        {"law": {"split": [["0", "0"], ["1e100", "0"]]}}, {"law": {"epsilon": "1e100"}}, {"law": {"share": "1e-100"}},
        {
            "law": {
                "F": [["1e100", "0"], ["0", "1e-100"]], "split": [["0", "0"], ["1e100", "0"]], "sigma": "1e-100",
                "T_min": "1e100",
            }
        },
    ],
)  # fmt: skip
def test_extreme_numbers_prove_nothing_and_break_nothing(options: dict[str, object]) -> None:
    family = card(**options)
    check = family.certify(PLANT, family.synthesize(PLANT, 0), 0)
    assert check.verdict == "undecided" and not check.bounds


def test_an_error_beyond_all_numbers_is_no_bound() -> None:
    family = card(law={"idle": "1e-100"})
    check = family.certify(PLANT, family.synthesize(PLANT, 0), 0)
    statuses = {claim.id: claim.status for claim in check.claims}
    assert statuses["convergence"] == "proved" and check.verdict == "undecided"
    assert statuses["error_bounded"] == "undecided" and "error.x1" not in check.bounds


def test_a_c_without_a_bound_and_a_law_without_a_split_are_told(budgeted: tuple[Design, Check, Law]) -> None:
    from cdobs_cli.exact.parser import parse

    unbounded = replace(PLANT, inputs=(replace(PLANT.inputs[0], range=None),), slopes=PLANT.slopes)
    design = card(c=parse("abs(u)", frozenset({"u"}))).synthesize(unbounded, 0)
    assert design.outcome == "none" and "no bound" in (design.reason or "")
    _, _, law = budgeted
    typed = {"F": law.F.texts(), "split": law.split.texts(), "sigma": str(law.sigma), "T_min": str(law.T_min)}
    design = card(law=typed).synthesize(chain(2, ["0", "sin(x1) + sin(x2)"], [["0", "0"], ["1", "1"]]), 0)
    assert design.outcome == "none" and "split" in (design.reason or "")


# ---------------------------------------------------------------- what validate says


@pytest.mark.parametrize(
    ("options", "at"),
    [
        ({"gain": {"K": [["1"], ["1"]], "alpha": 1, "a1": "0.1", "a2": 1, "a3": 0}}, "gain"),
        ({"objective": "given_alpha"}, "objective"),
        ({"variant": "last_row"}, "variant"),
        ({"rule": {"trigger": "integral"}}, "rule"),
        ({"rule": {"kappa": 1}}, "rule"),
        ({"budget": 5, "law": {"T_min": 1}}, "budget"),
        ({"objective": "min_error"}, "objective"),
        ({"error_at_most": {"x9": 1}}, "error_at_most.x9"),
        ({"error_at_most": {"x1": 1}, "budget": 5}, "error_at_most"),
        ({"law": {"F": [["1", "0"], ["0", "1"]]}}, "law.F"),
        ({"law": {"split": [["1"]]}}, "law.split"),
        ({"law": {"split": [["1", "0"], ["0", "1"]]}}, "law.split[1][0]"),
        ({"law": {"theta": 1}}, "law.theta"),
        ({"law": {"idle": 2}}, "law.idle"),
        ({"law": {"Lambda": [["-1"]]}}, "law.Lambda"),
        ({"law": {"gamma": [["0", "1"]]}}, "law.gamma"),
        ({"law": {"share": 2}}, "law.share"),
        ({"law": {"sigma": "sqrt(2)"}}, "law.sigma"),
        ({"law": {"Lambda": [["sqrt(2)"]]}}, "law.Lambda"),
        (
            {"law": {"F": [["1", "0"], ["0.1", "1"]], "split": [["0", "0"], ["1", "0"]], "sigma": 1, "T_min": 1}},
            "law.F",
        ),
    ],
)
def test_what_does_not_go_together_is_told_at_its_place(options: dict[str, object], at: str) -> None:
    assert {one.path for one in problems(card(**options), PLANT)} == {f"observer.{at}"}


def test_the_plant_need_not_be_a_chain_but_its_outputs_are_linear() -> None:
    assert not problems(card(), replace(PLANT, A=ExactMatrix([[-1, 2], [3, 0]]), C=ExactMatrix([[0, 1]])))
    white = replace(PLANT, intensity=ExactMatrix([[1, 0], [0, 1]]))
    assert [one.path for one in problems(card(), white)] == ["plant.disturbance"]
    of_theorems = UpdatedSampling.model_validate({"family": "updated_sampling", "budget": 5, "objective": "min_error"})
    assert {one.path for one in problems(of_theorems, PLANT)} == {"observer.budget", "observer.objective"}


def test_after_a_sample_pi_has_what_was_read() -> None:
    assert after_sample([[1, 2], [2, 5]], [[1, 0], [1, 1]], [3, 4]) == [[8, 6], [6, 9]]


def test_one_output_is_read_at_a_sample_and_both_have_their_turn() -> None:
    options = {**BUDGETED, "read": "one"}
    family, (design, check, law) = card(**options), designed(options, TWO)
    assert check.verdict == "proved" and law.one
    observer = family.observer(TWO, design)
    signals = {**_plan("0.2 + 9.8*max(0, sin(0.5*t))**8").signals}
    signals["v.1"] = signals["v.0"]
    plan = replace(_plan("1", horizon="12"), signals=signals)
    run = simulate(HybridSystem(TWO, observer), plan, TWO.sampling)
    told = reads(law, run.trajectories[0])
    assert set(told) == {"output 1 read", "output 2 read"}
    # What the sample adds is of rank one, and that of the output told.
    first = run.trajectories[0]
    for sample, which in zip(first.t_k[1:8], told, strict=False):
        before, after = (np.searchsorted(first.t, sample, side=side) for side in ("left", "right"))
        added = [
            first.internals[name][after - 1] - first.internals[name][before] for name in ("Pi_11", "Pi_12", "Pi_22")
        ]
        k = int(which.split()[1]) - 1
        row, weight = TWO.C.floats[k], float(law.Lambda[0, k])
        expected = weight * np.array([row[0] ** 2, row[0] * row[1], row[1] ** 2])
        assert np.array(added) == pytest.approx(expected, rel=1e-6, abs=1e-6 * weight)
    assert run.overall.rmse_after_transient["x1"] < float(check.bounds["error.x1"].proved or 0)


def test_an_output_that_is_not_enough_by_itself_leaves_no_choice() -> None:
    blind = replace(TWO, C=ExactMatrix([["1", "0"], ["0", "1"]]))
    assert card(**BUDGETED).synthesize(blind, 0).outcome == "found"
    assert card(**BUDGETED, read="one").synthesize(blind, 0).outcome == "none"
    told = [str(one.field) for one in problems(card(**BUDGETED, read="one"), PLANT)]
    assert told == ["('observer', 'read')"]


def test_pi_stays_within_what_floats_hold_where_the_plant_forgets_quickly() -> None:
    """Without gamma Pi_11 grows like exp(16 t), for ever."""
    slopes = [["0", "0"], ["0", "2"]]
    quick = replace(chain(2, ["0", "u*sin(x2)"], slopes, {"u": ("0", "2")}), A=ExactMatrix([[-8, 0], [0, 0]]))
    quick = replace(quick, C=ExactMatrix([[1, 0], [0, 1]]), noise=Box((Exact("-0.01"),) * 2, (Exact("0.01"),) * 2))
    design, check, law = designed({"budget": 8}, quick)
    assert check.verdict == "proved" and law.gamma[0, 0].sign() == 1
    signals = {**_plan("1+sin(t)").signals}
    signals["v.1"] = signals["v.0"]
    run = simulate(
        HybridSystem(quick, card(budget=8).observer(quick, design)),
        replace(_plan("1", runs=1, horizon="60"), signals=signals), quick.sampling,
    )  # fmt: skip
    assert not run.overall.diverged and run.trajectories[0].stopped is None
    assert run.trajectories[0].internals["Pi_11"].max() < 1e12 * float(law.F[0, 0])


@pytest.mark.parametrize("small", ["1e-3", "1e-13", "1e-30"])
def test_the_least_eigenvalue_is_near_however_far_the_others_are(small: str) -> None:
    turn = ExactMatrix([["3/5", "-4/5"], ["4/5", "3/5"]]).balls()
    F = turn @ ExactMatrix([["1", "0"], ["0", small]]).balls() @ turn.T
    least = least_eigenvalue(F)
    assert 0.999 * float(small) <= float(least.mid()) and not least > float(small)
