"""Where the widths settle: only where the map of the width is proved to contract, and never below what a run shows."""

from dataclasses import replace
from fractions import Fraction
from math import exp

import numpy as np
import pytest
from interval_plants import PRINTED, box, pendulum, plant, question, scalar, up_to
from replayed import Bounds, split
from scipy.linalg import expm

from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.interval import Feedback, Gain, Interval
from cdobs_cli.families.interval.analysis import Analysis
from cdobs_cli.families.interval.hull import Hull
from cdobs_cli.families.interval.hurwitz import refute_width, width_contracts, width_growth
from cdobs_cli.families.interval.intersect import intersected_width
from cdobs_cli.families.interval.system import System
from cdobs_cli.families.interval.theorems import Coordinates, width_matrix
from cdobs_cli.families.interval.widths import comparison, plain_width
from cdobs_cli.sampling import SamplingLaw


def periodic(T):
    return SamplingLaw.periodic(Exact(T))


def checked(at, gain, **options):
    family = Interval(gain=gain, **options)
    return family.certify(at, family.synthesize(at, 0), 0)


@pytest.mark.parametrize("tighten", ["none", "intersect"])
def test_a_width_that_diverges_has_no_final_value(tighten):
    """E_w = exp(-1) - 10 (1 - exp(-1)) = -5.95 at T = 1."""
    at = plant([["-1"]], [["1"]], periodic("1"), disturbance=box(["-0.1"], ["0.1"]), noise=box(["-0.1"], ["0.1"]))
    check = checked(at, Gain(S=[[1]], L=[["10"]]), tighten=tighten)
    assert not [name for name in check.bounds if name.startswith("final_width")]
    assert check.verdict != "proved"
    if tighten == "none":
        claim = check.claim("boundedness")
        assert check.verdict == "refuted" and claim.status == "refuted"
        assert float(claim.witness.multiplier) == pytest.approx(10 * (1 - exp(-1)) - exp(-1), rel=1e-9)
    else:
        assert check.claim("boundedness").status == "undecided"  # a cut is no linear map
    assert float(check.bounds["period_max"].proved) == pytest.approx(np.log(1.1), rel=1e-6)


def test_bounds_that_lose_the_state_have_no_final_width_even_where_they_settle():
    """E_w = -0.14 at T = 1.35: the width contracts, to bounds that x crosses."""
    check = checked(scalar(periodic("1.35")), Gain(S=[[1]], L=[["1.4"]]))
    assert check.claim("positivity").status == "refuted" and check.claim("boundedness").status == "proved"
    assert "final_width" not in check.bounds and check.verdict == "refuted"
    cut = checked(scalar(periodic("1.35")), Gain(S=[[1]], L=[["1.4"]]), tighten="intersect")
    assert cut.claim("boundedness").status == "undecided" and "final_width" not in cut.bounds  # a cut is no linear map


def test_a_hurwitz_matrix_alone_gives_no_width_beyond_the_orthant():
    at = scalar(periodic("1"))
    family = Interval(gain=Gain(S=[[1]], L=[["6"]]))
    a = Analysis(family, at, family.synthesize(at, 0), 0)
    assert a.hurwitz_rate is not None and not a.ordered
    assert plain_width(a) is None
    assert set(comparison(a)) <= {"hull"}


@pytest.mark.parametrize(
    ("L", "T", "contracts"),
    [("1.4", "0.35", True), ("1.4", "1.35", True), ("0.9", "0.35", False), ("6", "0.1", True), ("6", "1", False)],
)
def test_contraction_of_the_width_is_that_of_its_multiplier(L, T, contracts):
    at = scalar(periodic(T))
    family = Interval(gain=Gain(S=[[1]], L=[[L]]))
    a = Analysis(family, at, family.synthesize(at, 0), 0)
    multiplier = exp(float(T)) - float(L) * (exp(float(T)) - 1)
    assert (abs(multiplier) < 1) == contracts
    one = ExactMatrix([[1]]).balls()
    assert width_contracts(a.system, one, at.sampling) == contracts
    assert (refute_width(a.system, at.sampling) is not None) == (not contracts)
    assert not width_contracts(a.system, -one, at.sampling)


@pytest.mark.parametrize(("longest", "contracts"), [("0.33", True), ("0.34", False), ("0.4", False)])
def test_what_contracts_in_the_middle_of_a_law_has_to_at_its_end(longest, contracts):
    """exp(T) - 6 (exp(T) - 1) = -1 at T = log(1.4): for the width and for the radius of the hull predictor."""
    at, one = scalar(up_to(longest, "0.1")), ExactMatrix([[1]])
    asked = question(at, {"S": one, "L": ExactMatrix([["6"]])})
    assert width_contracts(System.of(asked), one.balls(), at.sampling) == contracts
    assert Hull(at.sampling, one).prove(asked).holds == contracts


@pytest.mark.parametrize("seed", range(8))
def test_contraction_of_random_widths(seed):
    """Against |E_w| on a grid of periods: proved only if no period of the law grows w*."""
    rng = np.random.default_rng(seed)
    A, L = rng.normal(size=(2, 2)) - 0.5 * np.eye(2), rng.uniform(0, 4, (2, 1))
    text = lambda M: [[f"{v:.3f}" for v in row] for row in M]  # noqa: E731
    T = rng.uniform(0.1, 1.2)
    at = plant(text(A), [["1", "0"]], up_to(f"{T:.3f}"))
    family = Interval(gain=Gain(S=[[1, 0], [0, 1]], L=text(L)))
    a = Analysis(family, at, family.synthesize(at, 0), 0)
    w = np.array([1.0, rng.uniform(0.3, 3)])
    P, N = split(a.system.z.Q0.floats)
    H = sum(split(a.system.z.Q1.floats))
    largest = -np.inf
    for s in np.linspace(1e-3, 1, 60) * T:
        both = expm(np.block([[P + N, np.eye(2)], [np.zeros((2, 4))]]) * s)
        largest = max(largest, ((np.abs(both[:2, :2] + both[:2, 2:] @ H) @ w / w - 1) / s).max())
    if abs(largest) > 0.02:
        proved = width_contracts(a.system, ExactMatrix([["1"], [f"{w[1]:.15f}"]]).balls(), at.sampling)
        assert proved == (largest < 0)


def test_the_map_of_the_width_takes_couplings_by_their_size():
    Q0, Q1, s = np.array([[-1.0, -2.0], [0.5, 0.3]]), np.array([[-1.0, 0.0], [0.4, 0.0]]), 0.7
    F = np.array([[-1.0, 2.0], [0.5, 0.3]])
    both = expm(np.block([[F, np.eye(2)], [np.zeros((2, 4))]]) * s)
    exact_Q0, exact_Q1 = Matrix.from_floats(Q0), Matrix.from_floats(Q1)
    Phi, _ = width_growth(exact_Q0, width_matrix(exact_Q0, exact_Q1), Matrix.from_floats([[s]]).balls()[0, 0])
    assert np.allclose(np.eye(2) + s * Phi.floats, both[:2, :2] + both[:2, 2:] @ Q1)


def test_with_the_hull_predictor_no_run_of_other_bounds_is_told():
    check = checked(scalar(periodic("1.5")), Gain(S=[[1]], L=[["1.4"]]), tighten="hull")
    claim = check.claim("positivity")
    assert claim.status == "undecided" and claim.witness is None
    assert claim.statement.startswith("without the hull predictor")


def test_a_width_whose_boxes_span_no_direction_is_not_refuted():
    """|S| = [1 1; 1 1] starts widths along (1, 1) only: that some other direction grows says nothing."""
    at = plant([["-1", "0"], ["0", "-1"]], [["1", "0"]], periodic("1"))
    family = Interval(gain=Gain(S=[[1, 1], [1, -1]], L=[["10"], ["0"]]))
    a = Analysis(family, at, family.synthesize(at, 0), 0)
    assert refute_width(a.system, at.sampling) is None


def test_beyond_the_orthant_the_cone_settles_at_the_same_width():
    """(3.8, 13.4) at T = 0.2895 too, where E(s) >= 0 fails; bounds are on their safe sides."""
    check = checked(pendulum(up_to("0.2895")), PRINTED)
    assert check.verdict == "proved"
    for name, value in (("final_width.x1", "3.8"), ("final_width.x2", "13.4"), ("final_width", "17.2")):
        bound = check.bounds[name]
        assert bound.better == "less"
        assert Exact(bound.refuted).rational <= Exact(value).rational <= Exact(bound.proved).rational
        assert float(bound.proved) - float(bound.refuted) < 1e-8


def settled(at, gain, cut, steps=140, seed=0, phases=5):
    """The largest widths of x in the second half of a long run, over random periods, d and v at corners."""
    rng = np.random.default_rng(seed)
    sides = ((box.lower, box.upper) for box in (at.disturbance, at.noise))
    ends = [tuple(np.array([float(v) for v in side]) for side in pair) for pair in sides]
    bounds = Bounds(at.A.floats, at.C.floats, gain.S.floats, gain.L.floats, *ends, cut=cut)
    n, high, low = at.n, float(at.sampling.T_max), float(at.sampling.T_min)
    bounds.start(np.zeros(n), -np.ones(n), np.ones(n))
    widest = np.zeros(n)
    for k in range(steps):
        T = high if k % 2 else rng.uniform(max(low, 0.05 * high), high)
        bounds.sample(rng.choice([0, 1], at.p) * (ends[1][1] - ends[1][0]) + ends[1][0])
        if k > steps / 2:
            for share in np.linspace(0, 1, phases):
                _, lower, upper, _ = bounds.after(share * T, np.zeros(n))
                widest = np.maximum(widest, upper - lower)
        bounds.flow(T, np.zeros(n))
        bounds.lower, bounds.upper = bounds.lower - bounds.S @ bounds.x, bounds.upper - bounds.S @ bounds.x
        bounds.x = np.zeros(n)
    return widest


def test_the_intersected_width_of_a_scalar_is_its_closed_form():
    """Cut to the noise r = 0.2 at samples: E_w(T) r + (exp(T) - 1) (0.2 + 1.4 0.2) just before the next one."""
    for T in (0.1, 0.35, 0.8):
        at = scalar(periodic(str(T)))
        bound = checked(at, Gain(S=[[1]], L=[["1.4"]]), tighten="intersect").bounds["final_width"]
        growth = exp(T) - 1
        value = min(1.2, 0.2 * (1 + growth - 1.4 * growth) + growth * 0.48)
        assert bound.refuted is None and value <= float(bound.proved) < value * 1.01


@pytest.mark.parametrize("T", ["0.1", "0.25"])
def test_the_intersected_width_of_the_pendulum_is_between_a_run_and_a_little_more(T):
    at = pendulum(up_to(T))
    check = checked(at, PRINTED, tighten="intersect")
    seen = settled(at, PRINTED, [(0, np.array([2**0.5]))])
    proved = np.array([float(check.bounds[f"final_width.{name}"].proved) for name in at.states])
    assert np.all(seen <= proved * (1 + 1e-9))
    assert np.all(proved < (1.6 if T == "0.1" else 1.8) * seen)
    plain = checked(at, PRINTED)
    assert np.all(proved < 0.7 * np.array([float(plain.bounds[f"final_width.{name}"].proved) for name in at.states]))


def iterated(F, H, restart, w, c, T):
    """`intersected_width` on a fine grid of s in floats: measured rows restart and peak, the others settle."""
    n, bound = len(w), w.copy()
    others = [i for i in range(n) if i not in restart]
    measured = list(restart)
    grid = [expm(np.block([[F, np.eye(n)], [np.zeros((n, 2 * n))]]) * s) for s in np.linspace(0, T, 301)]
    for _ in range(12):
        start = np.array([min(bound[i], restart.get(i, np.inf)) for i in range(n)])
        runs = np.array([both[:n, :n] @ start + both[:n, n:] @ (H @ start + c) for both in grid])
        for i in measured:
            bound[i] = min(bound[i], runs[:, i].max())
        if others:
            drive = c[others] + F[np.ix_(others, measured)] @ bound[measured] + (np.maximum(H, 0) @ start)[others]
            bound[others] = np.minimum(bound[others], np.linalg.solve(-F[np.ix_(others, others)], drive))
    return bound


@pytest.mark.parametrize("seed", range(16))
def test_each_step_of_the_intersected_width(seed):
    """Data that no long run would show as well: bounds far above what settles, so that peaks are early or between."""
    rng = np.random.default_rng(seed)
    n = 1 + seed % 3
    F = rng.uniform(0, 1, (n, n)) * (rng.random((n, n)) < 0.8) - np.diag(rng.uniform(2, 6, n))
    first = np.arange(n) == 0
    H = np.diag(np.where(first, -rng.uniform(0, 0.5), 0.0)) + np.where(first[:, None], 0.0, 0.2) * first
    w, c, T = rng.uniform(1, 8, n), rng.uniform(0, 1, n), rng.uniform(0.1, 0.8)
    G, noise = np.array([[rng.uniform(-2, 2)]]), rng.uniform(0.2, 3)
    exactly = lambda M: Matrix.from_floats(np.array(M).tolist())  # noqa: E731
    z = Coordinates(exactly(np.eye(n)), exactly(np.eye(n)), exactly(F), exactly(H), exactly(np.zeros((n, 1))))
    columns = (exactly(value) for value in (w[:, None], c[:, None], [[noise]]))
    found = intersected_width(z, {0: exactly(G)}, *columns, Fraction(T))
    expected = iterated(F, H, {0: abs(G[0, 0]) * noise}, w, c, T)
    values = found.floats.ravel()
    assert np.all(values >= expected * (1 - 1e-9)) and np.all(values <= expected * 1.08)


@pytest.mark.parametrize("seed", range(4))
def test_random_intersected_widths_are_never_passed_by_a_run(seed):
    rng = np.random.default_rng(seed)
    n, p = (2, 1) if seed % 2 else (3, 2)
    text = lambda M: [[f"{v:.2f}" for v in row] for row in M]  # noqa: E731
    A, C = rng.normal(size=(n, n)) - 0.3 * np.eye(n), np.eye(n)[:p] + 0.3 * np.eye(n)[n - p :]
    at = plant(text(A), text(C), up_to("0.1"), disturbance=box([-1] * n, [2] * n), noise=box(["-0.1"] * p, ["0.3"] * p))
    family = Interval(tighten="intersect")
    design = family.synthesize(at, 0)
    check = family.certify(at, design, 0)
    assert check.verdict == "proved"
    gain = Gain(S=design.gain["S"], L=design.gain["L"])
    seen = settled(at, gain, [(i, np.eye(p)[i]) for i in range(p)], steps=160, seed=seed, phases=4)
    proved = np.array([float(check.bounds[f"final_width.{name}"].proved) for name in at.states])
    assert np.all(seen <= proved * (1 + 1e-9)) and np.all(proved < 4 * seen)


# ---------------------------------------------------------------- designs that are not the spec's


def test_a_design_without_the_feedback_asked_for_is_not_proved():
    at = scalar(up_to("0.35"))
    given = Feedback(K_lower=[[-3]], K_upper=[[-3]])
    family = Interval(gain=Gain(S=[[1]], L=[["1.4"]]), feedback=given)
    design = family.synthesize(at, 0)
    assert family.certify(at, design, 0).verdict == "refuted"
    without = {"S": design.gain["S"], "L": design.gain["L"]}
    one = ExactMatrix([["-0.5"]])
    changed = [
        without,
        {**without, "K_lower": given.K_lower},
        {**without, "K_upper": given.K_upper},
        {**without, "K_lower": one, "K_upper": one},
    ]
    changed += [{**design.gain, "L": ExactMatrix([["1.3"]])}, {**design.gain, "S": ExactMatrix([["2"]])}]
    for gain in changed:
        check = family.certify(at, replace(design, gain=gain), 0)
        assert check.verdict == "undecided" and "nothing is claimed of it" in check.claim("convergence").statement
    searched = Interval(feedback="design")
    assert searched.certify(at, replace(design, gain=without), 0).verdict == "undecided"
    none = Interval(gain=family.gain)
    assert "does not ask for" in none.certify(at, design, 0).claim("convergence").statement


def test_a_hull_frontier_of_another_law_is_not_read():
    at = scalar(up_to("0.35", "0.01"))
    family = Interval(gain=Gain(S=[[1]], L=[["1.4"]]), tighten="hull")
    design = family.synthesize(at, 0)
    bound = family.certify(at, design, 0).bounds["period_max"]
    moved = tuple(replace(c, sampling=periodic("1.5")) if c.sampling != at.sampling else c for c in design.certificates)
    hull = Hull(periodic("1.5"), ExactMatrix([[1]]))
    assert hull.certificate() in moved and hull.prove(question(at, design.gain, tighten="hull")).holds
    other = family.certify(at, replace(design, certificates=moved), 0).bounds["period_max"]
    assert float(bound.proved) > 0.5 and float(other.proved) == pytest.approx(0.35)


def test_the_width_matrix_is_what_the_fixed_point_solves():
    """-Mtot w = c for the printed pendulum: w = (3.8 sqrt(2), 9.6)."""
    at = pendulum(up_to("0.1"))
    family = Interval(gain=PRINTED)
    a = Analysis(family, at, family.synthesize(at, 0), 0)
    assert np.allclose(width_matrix(a.system.z.Q0, a.system.z.Q1).floats, [[-3, 2**0.5], [2**0.5, -1]])
