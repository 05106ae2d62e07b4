"""Enclosure from boxes of x(0): what the cone proves holds when run, what a box refutes is lost when run."""

from dataclasses import replace
from fractions import Fraction
from math import exp, sqrt

import numpy as np
import pytest
from interval_plants import PENDULUM_L, PENDULUM_S, box, exact, pendulum, plant, scalar, up_to
from replayed import Bounds, replay
from scipy.linalg import expm
from scipy.optimize import brentq, nnls

from cdobs_cli.design import Design
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.interval import Gain, Interval
from cdobs_cli.families.interval.analysis import Analysis
from cdobs_cli.families.interval.cone import Cone
from cdobs_cli.families.interval.crossing import Crossing, distance, refutes
from cdobs_cli.families.interval.crossing_search import crossing_from_box, crossing_from_signals
from cdobs_cli.families.interval.errors import ErrorSystem
from cdobs_cli.families.interval.rays import extreme_rays
from cdobs_cli.families.interval.system import System
from cdobs_cli.sampling import SamplingLaw

A, C = [["1.5", "1.5"], ["-1.6", "-1.6"]], [["1", "0"]]
S, L = [["1", "0"], ["1", "1"]], [["2"], ["-2"]]
GAIN = Gain(S=S, L=L)


def lagging(law, **data):
    """Two states whose sum drives the measured one: the cone 0 <= e1 <= 2.5 e2 holds its errors until T = 0.954."""
    return plant(A, C, law, **data)


def checked(at, gain=GAIN, effort=0, **options):
    family = Interval(gain=gain, **options)
    design = Design.from_document(family.synthesize(at, effort).document())
    return design, family.certify(at, design, effort)


def longest_for_boxes():
    """From e = (0, 1) two equal periods end at e1 = 15 (1 - E) (1 - 2 T + E), E = exp(-T/10)."""
    return brentq(lambda T: 1 - 2 * T + exp(-T / 10), 0.1, 2)


def test_a_cone_proves_what_the_orthant_does_not():
    design, check = checked(lagging(up_to("0.7")))
    assert check.verdict == "proved" and "cone" in check.claim("positivity").statement
    assert "e1 <= 2.5352 e2" in check.claim("positivity").statement
    assert check.claim("boundedness").status == "proved" and "cone" in check.claim("boundedness").method
    orthant, reached = check.bounds["positivity_period_max.orthant"], check.bounds["positivity_period_max"]
    assert float(orthant.proved) < 0.5 < float(orthant.refuted)
    assert float(orthant.refuted) - float(orthant.proved) < 1e-6
    assert float(reached.proved) < longest_for_boxes() < float(reached.refuted)
    assert float(reached.refuted) - float(reached.proved) < 3e-5
    assert check.bounds["period_max"].proved == reached.proved and check.bounds["period_max"].refuted == reached.refuted
    assert [one.sampling == up_to("0.7") for one in design.certificates if one.method == "cone"] == [True, False]


@pytest.mark.parametrize("law", [up_to("0.96"), SamplingLaw.periodic(Exact("0.96")), up_to("0.96", "0.9")])
def test_beyond_the_cone_a_box_and_a_word_refute(law):
    _, check = checked(lagging(law))
    witness = check.claim("convergence").witness
    assert check.verdict == "refuted" and witness.kind == "box" and witness.times == ("0.96",)
    found = replay(Bounds(*(ExactMatrix(M).floats for M in (A, C, S, L))), witness)
    assert found < 0 and abs(found - float(witness.data["distance"])) < 1e-9


def test_the_pendulum_of_the_paper_lasts_longer_from_boxes_of_x():
    """The first column sqrt(2) E_11 + E_14 of E(s) [S^+ S^-; S^- S^+] is the first to turn negative."""
    root = sqrt(2)
    M = np.array([[1, root, 0, 0], [0, -1, root, 0], [0, 0, 1, root], [root, 0, 0, -1]])
    N1 = np.diag([-4, 0, -4, 0])

    def first(s):
        both = expm(np.block([[M, np.eye(4)], [np.zeros((4, 8))]]) * s)
        E = both[:4, :4] + both[:4, 4:] @ N1
        return root * E[0, 0] + E[0, 3]

    limit = brentq(first, 0.1, 0.5)
    assert abs(limit - 0.28997) < 5e-6
    _, check = checked(pendulum(up_to("0.1")), Gain(S=PENDULUM_S, L=PENDULUM_L))
    found = check.bounds["positivity_period_max"]
    assert float(found.proved) < limit < float(found.refuted) and float(found.refuted) - float(found.proved) < 1e-5


def test_noise_alone_leaves_the_cone():
    """Its share of e1 comes without any of e2: two samples of opposite noise cross a bound from a known state."""
    at = lagging(up_to("0.7"), noise=box(["-0.1"], ["0.1"]))
    _, check = checked(at)
    witness = check.claim("positivity").witness
    assert check.verdict == "refuted" and witness.data["lower"] == witness.data["upper"] == ["0", "0"]
    assert len(witness.data["noise"]) == 2 and witness.data["noise"][0] != witness.data["noise"][1]
    ends = np.array([-0.1]), np.array([0.1])
    data = (ExactMatrix(matrix).floats for matrix in (A, C, S, L))
    assert replay(Bounds(*data, v_box=ends), witness) < 0


@pytest.mark.parametrize(("d", "v", "proved"), [("0.5", "0.1", True), ("0.001", "0.5", False), ("0.5", "5", False)])
def test_disturbance_and_noise_are_weighed_together(d, v, proved):
    """The noise of the pendulum alone would leave the cone; the disturbance brings along what carries it."""
    at = replace(pendulum(up_to("0.2895")), disturbance=box([f"-{d}"] * 2, [d] * 2), noise=box([f"-{v}"], [v]))
    assert (checked(at, Gain(S=PENDULUM_S, L=PENDULUM_L))[1].claim("positivity").status == "proved") == proved


def test_the_measured_row_may_be_cut():
    design, check = checked(lagging(up_to("0.7")), tighten="intersect")
    assert check.claim("positivity").status == check.claim("boundedness").status == "proved"
    assert check.verdict == "proved" and "final_width" not in check.bounds
    stored = next(c for c in design.certificates if c.method == "cone")
    assert stored.sampling == up_to("0.7") and all(Exact(row[0]).sign() == 1 for row in stored.data["omega"])


# ---------------------------------------------------------------- what must not be proved


def analysis(at, cone=None, tighten="none", gain=GAIN):
    """An analysis whose design holds one cone at its law."""
    family = Interval(gain=gain, tighten=tighten)
    design = family.synthesize(at, 0)
    stored = [c for c in design.certificates if c.method == "cone" and c.sampling == at.sampling]
    kept = [replace(cone, law=at.sampling).certificate()] if cone is not None and stored else stored
    hurwitz = [c for c in design.certificates if c.method == "hurwitz"]
    return Analysis(family, at, replace(design, certificates=(*hurwitz, *kept)), 0)


def rows(*entries, law=None, unit=("0.775", "1", "0.775", "1"), omega=None):
    column = lambda values: None if values is None else ExactMatrix([[value] for value in values])  # noqa: E731
    return Cone(law or up_to("0.7"), ExactMatrix(entries), column(unit), column(omega))


FITTING = (["-1", "2.5", "0", "0"], ["0", "0", "-1", "2.5"])


def test_the_cone_of_the_note_is_proved():
    a = analysis(lagging(up_to("0.7")), rows(*FITTING))
    assert a.cone is not None and a.shrinks


@pytest.mark.parametrize(
    ("entries", "why"),
    [
        ((["-1", "2.6", "0", "0"], ["0", "0", "-1", "2.6"]), "at e = (2.6, 1) the orthant is left"),
        ((["-1", "0.99", "0", "0"], ["0", "0", "-1", "2.5"]), "a unit box starts at (1, 1)"),
        ((["-1", "2.5", "0", "0"], ["0", "0", "-1", "0.99"]), "the same of the upper bound"),
        ((["-1", "1", "0", "0"], ["0", "0", "-1", "1"]), "holds the start; (0, 1) leaves it upwards"),
        ((["-1", "2.5", "0", "0"],), "the upper bound is free to leave"),
        ((["0", "0", "-1", "2.5"],), "the lower bound is free to leave"),
        ((["-1", "2.5", "0", "0"], ["0", "0", "1", "-0.1"]), "no box starts there"),
        ((["-1", "2.5", "0"], ["0", "0", "-1"]), "of another plant"),
        ((["-1", "sqrt(6)", "0", "0"], ["0", "0", "-1", "sqrt(6)"]), "its rays are not rational"),
    ],
)
def test_a_cone_that_does_not_hold_the_errors_is_not_believed(entries, why):
    a = analysis(lagging(up_to("0.7")), rows(*entries))
    assert a.cone is None, why


def test_a_cone_of_another_law_is_not_believed():
    at = lagging(up_to("0.7"))
    family = Interval(gain=GAIN)
    design = family.synthesize(at, 0)
    own, longest = (c for c in design.certificates if c.method == "cone")
    assert Analysis(family, at, design, 0).enclosed_by_cones() == [Exact("0.7"), longest.sampling.T_max]
    shorter = Analysis(family, at, replace(design, certificates=(replace(own, sampling=up_to("0.6")),)), 0)
    assert shorter.cone is None and shorter.enclosed_by_cones() == [Exact("0.6")]
    moved = replace(longest, sampling=SamplingLaw.periodic(Exact("0.9")))
    assert Analysis(family, at, replace(design, certificates=(own, moved)), 0).enclosed_by_cones() == [Exact("0.7")]


def test_between_samples_the_orthant_counts_also_where_no_sample_may_come():
    """e1 = 1 - 8 s + 0.75 (exp(2 s) - 1) is positive again at T = 2: samples keep the cone e1 <= e2."""
    at = plant([["1.5", "1.5"], ["0.5", "0.5"]], C, SamplingLaw.periodic(Exact("2")))
    gain = Gain(S=S, L=[["8"], ["-8"]])
    _, check = checked(at, gain)
    witness = check.claim("convergence").witness
    assert check.verdict == "refuted" and witness.times == () and float(witness.data["after"]) < 1.5
    family = Interval(gain=gain)
    design = family.synthesize(at, 0)
    cone = rows(["-1", "1", "0", "0"], ["0", "0", "-1", "1"], law=at.sampling)
    a = Analysis(family, at, replace(design, certificates=(cone.certificate(),)), 0)
    assert cone.is_invariant(a.system.errors) and a.cone is None


@pytest.mark.parametrize(
    ("unit", "omega", "cut", "shrinks"),
    [
        (("0.775", "1", "0.775", "1"), None, False, True),
        (("0.775", "1", "0.775", "1"), None, True, False),  # a cut does not keep the order of the cone
        (None, ("0.07", "1.9", "0.07", "1.9"), True, True),
        (None, ("0.07", "1.9", "0.07", "1.9"), False, True),
        (("-0.775", "-1", "-0.775", "-1"), None, False, False),
        (("2.6", "1", "2.6", "1"), None, False, False),  # outside the cone
        (("0.775", "1", "0.775"), None, False, False),
        (("0.1", "1", "0.1", "1"), None, False, False),  # e1 grows from there
        (None, ("0.07", "-1.9", "0.07", "1.9"), False, False),
        (None, ("1", "0.5", "1", "0.5"), False, False),  # e2 feeds e1 faster than it decays
        (None, ("0.07", "1.9", "0.07"), False, False),
        (None, None, False, False),
    ],
)
def test_what_shows_that_the_errors_shrink_is_itself_proved(unit, omega, cut, shrinks):
    a = analysis(lagging(up_to("0.7")), rows(*FITTING, unit=unit, omega=omega), "intersect" if cut else "none")
    assert a.cone is not None and a.shrinks == shrinks


def test_a_cone_that_a_cut_leaves_is_not_believed_where_rows_are_cut():
    """e2 carried by e1: setting e1 to 0 leaves the cone."""
    entries = (*FITTING, ["3", "-0.001", "0", "0"], ["0", "0", "3", "-0.001"])
    assert analysis(lagging(up_to("0.7")), rows(*entries), "intersect").cone is None
    assert analysis(lagging(up_to("0.7")), rows(*FITTING), "intersect").cone is not None


def test_what_a_longer_cone_says_of_the_period_is_what_is_proved_of_it():
    """Enclosed only, or for a shorter period than the law's own: `period_max` takes neither for more."""
    at, family = lagging(up_to("0.7")), Interval(gain=GAIN)
    design = family.synthesize(at, 0)

    def with_frontier(law, **changes):
        own = [c for c in design.certificates if c.method != "cone" or c.sampling == at.sampling]
        kept = next(c for c in design.certificates if c not in own)
        changed = replace(kept, sampling=law or kept.sampling, data=kept.data | changes)
        return replace(design, certificates=(*own, changed))

    loose = Analysis(family, at, with_frontier(None, unit=None, omega=None), 0)
    assert len(loose.enclosed_by_cones()) == 2 and loose.enclosed_by_cones(bounded=True) == [Exact("0.7")]
    short = family.certify(at, with_frontier(up_to("0.6")), 0)
    assert float(short.bounds["period_max"].proved) == pytest.approx(0.7) and short.verdict == "proved"


def system(A, C, S, L, cut=()):
    z = exact(A, C, S, L)
    return ErrorSystem.of(z, Matrix.zeros(len(A), 1), Matrix.zeros(len(C), 1), cut)


def test_a_cone_that_is_kept_but_does_not_hold_the_start_proves_nothing():
    """e1 <= 0.9 e2 lasts for T = 0.3; a box of x1 starts at (1, 1)."""
    errors, law = system(A, C, S, L), up_to("0.3")
    assert rows(["-1", "1.1", "0", "0"], ["0", "0", "-1", "1.1"], law=law).encloses(errors)
    thin = rows(["-1", "0.9", "0", "0"], ["0", "0", "-1", "0.9"], law=law)
    assert thin.is_invariant(errors) and not thin.encloses(errors)


def test_a_cone_that_a_cut_alone_leaves_proves_nothing_where_rows_are_cut():
    """z1 = x1 + x2 is measured: errors start with e1 >= e2 and keep e1 >= e2/2, unless y cuts e1."""
    data = ([["0", "1.6"], ["0", "-0.1"]], [["1", "1"]], [["1", "1"], ["0", "1"]], [["2"], ["0"]])
    cone = rows(["1", "-0.5", "0", "0"], ["0", "0", "1", "-0.5"], law=up_to("0.3"))
    assert cone.encloses(system(*data)) and not cone.encloses(system(*data, cut=(0,)))


@pytest.mark.parametrize(("share", "kept"), [("0.5", False), ("0.7", False), ("0.85", True)])
def test_a_face_that_is_left_at_once_is_seen_however_short_the_period(share, kept):
    """On e1 = c e2 the slope of c e2 - e1 is 1.9 c - 1.5."""
    cone = rows(["-1", share, "0", "0"], ["0", "0", "-1", share], law=up_to("0.001"))
    assert cone.is_invariant(system(A, C, S, L)) == kept


@pytest.mark.parametrize("signs", [(1, 1), (-1, -1)])
def test_what_grows_shrinks_in_no_negative_measure(signs):
    """e2 grows with exp(s/2): of u < 0 and of -e2 the decrease is formally positive."""
    errors = system([["1.5", "1.5"], ["-1", "-1"]], C, S, L)
    u, v = signs
    for cone in (
        rows(*FITTING, law=up_to("0.3"), unit=[str(0.5 * u), str(u), str(0.5 * u), str(u)]),
        rows(*FITTING, law=up_to("0.3"), unit=None, omega=["0.01", str(v), "0.01", str(v)]),
    ):
        assert not cone.shrinks(errors)


def test_errors_that_grow_are_not_called_bounded():
    """e1 and e2 stay in a cone and grow with exp(0.5 t)."""
    at = plant([["-1", "3"], ["0", "0.5"]], C, up_to("0.6"))
    _, check = checked(at, Gain(S=[[1, 0], [1, 1]], L=[["2"], ["-2"]]))
    assert check.verdict != "proved"


def test_touched_cones_are_not_believed():
    at = lagging(up_to("0.7"))
    family = Interval(gain=GAIN)
    design = family.synthesize(at, 0)
    for data in (
        {},
        {"H": "x", "unit": None, "omega": None},
        {"H": [["1"]], "unit": None, "omega": None},
        {"H": [], "unit": [["1"]], "omega": 3},
    ):
        touched = tuple(replace(c, data=data) if c.method == "cone" else c for c in design.certificates)
        check = family.certify(at, replace(design, certificates=touched), 0)
        assert check.verdict == "undecided" and check.claim("positivity").witness is None
        assert float(check.bounds["period_max"].proved) < 0.5


# ---------------------------------------------------------------- random plants, run


def random_data(rng):
    n = int(rng.integers(2, 4))
    a = rng.normal(size=(n, n)).round(2)
    c = np.eye(n)[:1]
    s = np.vstack([c, rng.normal(size=(n - 1, n)).round(2)])
    q = rng.uniform(1, 4)
    text = lambda m: [[f"{v:.6f}" for v in row] for row in m]  # noqa: E731
    return text(a), text(c), text(s), text((np.linalg.inv(s)[:, :1] * q).round(6))


@pytest.mark.parametrize("seed", range(6))
def test_random_plants_keep_what_is_proved_and_lose_what_is_refuted(seed):
    rng = np.random.default_rng(seed)
    data = random_data(rng)
    a, c, s, ell = (ExactMatrix(m).floats for m in data)
    n = len(a)
    noisy = seed % 3 == 0
    signals = {"disturbance": box(["-0.5"] * n, ["0.5"] * n), "noise": box(["-0.05"], ["0.05"])} if noisy else {}
    d_box = (np.full(n, -0.5), np.full(n, 0.5)) if noisy else None
    v_box = (np.array([-0.05]), np.array([0.05])) if noisy else None
    family = Interval(gain=Gain(S=data[2], L=data[3]))
    base = plant(data[0], data[1], up_to("0.1"), **signals)
    limit = Analysis(family, base, family.synthesize(base, 0), 0).system.limit
    for share in (0.97, 1.02, 1.3):
        T = f"{share * float(limit.proved):.6f}" if limit.proved else "0.5"
        law = (up_to(T), SamplingLaw.periodic(Exact(T)), up_to(T, f"{float(T) / 2:.6f}"))[seed % 3]
        at = replace(base, sampling=law)
        check = family.certify(at, family.synthesize(at, 0), 0)
        claim = check.claim("positivity")
        bounds = Bounds(a, c, s, ell, d_box, v_box)
        if claim.status == "refuted":
            data = claim.witness.data
            size = max(abs(float(Exact(text))) for text in (*data["lower"], *data["upper"], "1"))
            assert replay(bounds, claim.witness) < 0
            assert abs(replay(bounds, claim.witness) - float(claim.witness.data["distance"])) < 1e-8 * size
        if claim.status == "proved":
            assert worst_run(bounds, rng, float(law.T_min), float(law.T_max)) >= -1e-9


def worst_run(bounds, rng, low, high):
    """The least distance of the state from its bounds, relative to the box, over random words and corners."""
    n, worst = len(bounds.A), np.inf
    for _ in range(6):
        corner = rng.integers(0, 2, n)
        size = rng.choice([0.0, 1.0, 100.0], n)
        bounds.start(np.zeros(n), -size * (1 - corner), size * corner)
        for _ in range(8):
            T = rng.choice([high, rng.uniform(max(low, 1e-3 * high), high)])
            bounds.sample(np.array([rng.choice(bounds.v_box)[0]]))
            d = np.array([rng.choice([bounds.d_box[0][i], bounds.d_box[1][i]]) for i in range(n)])
            scale = 1 + size.max() + np.abs(np.concatenate([bounds.lower, bounds.upper])).max()
            worst = min(worst, *(bounds.margin(f * T, d) / scale for f in (0.5, 1.0)))
            bounds.flow(T, d)
    return worst


# ---------------------------------------------------------------- crossings and rays


def test_a_crossing_of_another_law_or_outside_its_box_is_no_witness():
    at = lagging(up_to("0.96"))
    plain = System(at, {"S": ExactMatrix(S), "L": ExactMatrix(L)})
    nothing, zero = ((False, False),) * 2, (Fraction(0), Fraction(0))
    T, low_v = Exact("0.96"), ((False,),) * 2
    good = Crossing((Fraction(0), Fraction(-1)), zero, zero, (T,), T, nothing, low_v, 0)
    assert refutes(plain, good, at.sampling) is not None
    for law in (up_to("0.95"), up_to("2", "0.97"), SamplingLaw.periodic(Exact("1"))):
        assert refutes(plain, good, law) is None
    for wrong in (
        replace(good, state=(Fraction(0), Fraction(1))), replace(good, state=(Fraction(0), Fraction(-2))),
        replace(good, component=1),
        replace(good, after=Exact("0.5")), replace(good, periods=(Exact(0),)), replace(good, after=Exact("-0.1")),
        replace(good, after=Exact("0.97")),
    ):  # fmt: skip
        assert refutes(plain, wrong, at.sampling) is None
    twice = replace(good, periods=(Exact("0.96"), Exact(0)), low_d=(*nothing, nothing[0]), low_v=((False,),) * 3)
    assert distance(plain, twice) < 0 and refutes(plain, twice, at.sampling) is None


@pytest.mark.parametrize(("seed", "by_signals"), [(0, False), (1, True), (2, False), (3, True)])
def test_crossings_are_seen_with_rows_cut_as_the_observer_cuts_them(seed, by_signals):
    """Two outputs, one of them no row of S: what it injects is not cut, and is lost when run."""
    rng = np.random.default_rng(seed)
    n = 3
    s, c = [["2", "0", "0"], ["0.4", "1", "-1"], ["0", "0", "1"]], [["1", "0", "0"], ["0", "1", "0"]]
    gains = [[f"{v:.3f}" for v in row] for row in rng.uniform(2, 4, (3, 2)) * [[1, 0.05], [0.05, 1], [0.02, 0.02]]]
    low_d, up_d, low_v, up_v = np.full(n, -0.01), np.full(n, 0.02), np.array([-0.01, -3]), np.array([0.02, 1])
    text = lambda values: [f"{v:.2f}" for v in values]  # noqa: E731
    at = plant(
        [["0.3", "1", "0.2"], ["-1", "0.2", "-0.4"], ["0.5", "0.1", "-0.3"]], c, up_to("1.5"),
        disturbance=box(text(low_d), text(up_d)), noise=box(text(low_v), text(up_v)),
    )  # fmt: skip
    gain = {"S": ExactMatrix(s), "L": ExactMatrix(gains)}
    data = (at.A.floats, at.C.floats, gain["S"].floats, gain["L"].floats, (low_d, up_d), (low_v, up_v))
    for found in (crossing_from_box, crossing_from_signals)[: 1 + by_signals]:
        witness = found(System(at, gain, cut=True), at.sampling)
        assert witness is not None
        lost = replay(Bounds(*data, cut=[(0, np.array([2.0, 0.0]))]), witness)
        size = max(abs(float(text)) for text in (*witness.data["lower"], *witness.data["upper"], "1"))
        assert lost < 0 and abs(lost - float(witness.data["distance"])) < 1e-8 * size


@pytest.mark.parametrize("seed", range(8))
def test_rays_generate_the_cone(seed):
    rng = np.random.default_rng(seed)
    size = int(rng.integers(2, 6))
    H = [[Fraction(int(v)) for v in rng.integers(-3, 4, size)] for _ in range(3)]
    rays = extreme_rays(H, size)
    G = np.array([[float(v) for v in ray] for ray in rays]).T.reshape(size, len(rays))
    floats = np.array(H, dtype=float)
    if len(rays):
        assert G.min() >= 0 and (floats @ G).min() >= -1e-12 and np.allclose(G.sum(axis=0), 1)
        for k in range(len(rays)):  # none is a combination of the others
            assert len(rays) == 1 or nnls(np.delete(G, k, axis=1), G[:, k])[1] > 1e-9
    for _ in range(200):
        e = rng.exponential(size=size) * rng.integers(0, 2, size)
        inside = (floats @ e).min() >= 0
        residual = nnls(G, e)[1] if len(rays) else np.linalg.norm(e)
        assert inside == (residual < 1e-9 * (1 + e.sum()))


def test_too_many_rays_are_given_up():
    rng = np.random.default_rng(0)
    H = [[Fraction(int(v)) for v in rng.integers(-9, 14, 10)] for _ in range(14)]
    assert extreme_rays(H, 10) is None


def test_irrational_periods_refute_as_they_are_typed():
    family = Interval(gain=Gain(S=[[1]], L=[["1.4"]]))
    at = scalar(SamplingLaw.periodic(Exact("log(3.6)")))
    check = family.certify(at, family.synthesize(at, 0), 0)
    assert check.verdict == "refuted" and check.claim("positivity").witness.data["after"] == "log(3.6)"
