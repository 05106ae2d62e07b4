"""Outputs whose slopes vary: what is proved of them, its nearest twin that is not, and random members."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from asking import analyse, design, longest, proof, proves
from example_inclusions import aperiodic, canonical, impulsive, periodic, plant
from scipy.linalg import block_diag, expm

from cdobs_cli.certify.falsify import refute
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.certificate import Clock
from cdobs_cli.certify.methods.dead_beat import EveryPeriod, resets
from cdobs_cli.certify.methods.open_loop import OpenLoop
from cdobs_cli.certify.unseen import unseen
from cdobs_cli.certify.words import refutes
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold
from cdobs_cli.families.lpv_zoh.theorems import error_maps, held_maps
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.plant import Box, Slopes
from cdobs_cli.simulate.witness import replay

SWING = [[0, 1], ["0.5", 0]]  # a saddle
ZERO = [[0, 0], [0, 0]]


def seen_through(made, lower, upper):
    """The plant with outputs whose slopes lie between these, shapes (p, n)."""
    H = Slopes(ExactMatrix(lower), ExactMatrix(upper))
    half = Exact(Fraction(1, 2))
    rows = zip(H.lower.rows, H.upper.rows, strict=True)
    C = [[(low + high) * half for low, high in zip(*row, strict=True)] for row in rows]
    return replace(made, C=ExactMatrix(C), H=H)


def pendulum(r, law):
    """|d phi_2 / d x_1| <= 1, an angle measured with a slope in [1 - r, 1 + r]."""
    return seen_through(canonical([1, 0], law), [[Exact(1) - Exact(r), 0]], [[Exact(1) + Exact(r), 0]])


def saddle(law, lower=(("0.8", "-0.2"),), upper=(("1.2", "0.2"),)):
    return seen_through(plant(SWING, ZERO, ZERO, [[1, 0]], law), lower, upper)


# The largest periods of the table in the theory of schemes, and how far above the same gain is refuted.
@pytest.mark.parametrize(("r", "T", "above"), [("0", "1.61", 1.1), ("0.1", "1.34", 1.1), ("0.2", "1.09", 1.1)])
def test_the_pendulum_is_proved_up_to_the_period_of_theory_and_refuted_above(r, T, above):
    no_gain = impulsive(pendulum(r, periodic(T)), [[0], [0]])
    met = design(no_gain, 1)
    assert met is not None
    K, certificate = met
    here = impulsive(pendulum(r, periodic(T)), K.rows)
    assert proves(here, certificate)
    assert refute(here, 1) is None
    beyond = impulsive(pendulum(r, periodic(str(float(T) * above))), K.rows)
    witness = refute(beyond, 1)
    assert witness is not None and refutes(beyond, witness)
    assert not refutes(here, witness)
    if r != "0":  # the same certificate does not serve wider slopes
        wider = impulsive(pendulum(str(2 * float(r)), periodic(T)), K.rows)
        assert not proves(wider, certificate)
        assert refute(wider, 1) is not None


def test_a_wide_output_still_has_a_gain_at_short_periods_only():
    assert design(impulsive(pendulum("0.5", periodic("0.53")), [[0], [0]]), 1) is not None
    assert design(impulsive(pendulum("0.5", periodic("0.7")), [[0], [0]]), 1) is None


def test_a_witness_is_about_its_own_slopes_of_the_outputs():
    K = [[1], ["0.85"]]
    wide = impulsive(pendulum("0.1", periodic("1.4")), K)
    witness = refute(wide, 1)
    assert witness is not None and refutes(wide, witness)
    (column,) = witness.data["outputs"]
    assert column["entry"] == [0, 0] and set(column["values"]) <= {"0.9", "1.1"}
    run = replay(wide, witness)
    assert run.multiplier == pytest.approx(float(witness.multiplier), rel=1e-6)
    assert np.linalg.norm(run.e[-1]) > 20 * np.linalg.norm(run.e[0])
    assert not refutes(impulsive(pendulum("0.05", periodic("1.4")), K), witness)  # 1.1 is no slope of this class
    assert not refutes(impulsive(canonical([1, 0], periodic("1.4")), K), witness)
    for damaged in ([], "x", [{}], [{"entry": [0, 0], "values": []}], [{"entry": [0, 1], "values": column["values"]}]):
        assert not refutes(wide, replace(witness, data={**witness.data, "outputs": damaged}))


@pytest.mark.parametrize("r", ["0.1", "0.3"])
def test_no_member_with_random_slopes_of_flow_and_outputs_leaves_the_proved_envelope(r):
    """Bang-bang and random V(t), random and extreme H at each sample."""
    law = aperiodic("0.2", "0.6")
    K, _ = design(impulsive(pendulum(r, law), [[0], [0]]), 1)
    inclusion = impulsive(pendulum(r, law), K.rows)
    asked = Question(inclusion, rate=Fraction(1, 10), effort=2)
    certificate = Clock.propose(asked)
    assert certificate is not None
    factor = certificate.factor(asked)
    maps, random = inclusion.floats, np.random.default_rng(3)
    for run in range(80):
        e, t = random.normal(size=2), 0.0
        e /= np.linalg.norm(e)
        for _ in range(40):
            w = (
                random.choice([maps.jump_lower[0], maps.jump_upper[0]])
                if run % 2
                else random.uniform(maps.jump_lower[0], maps.jump_upper[0])
            )
            e = maps.jump_at((w,)) @ e
            T = random.choice([0.2, 0.6, random.uniform(0.2, 0.6)])
            for _ in range(4):
                v = random.choice([-1.0, 1.0]) if run % 3 else random.uniform(-1, 1)
                e = expm(maps.flow((v,)) * T / 4) @ e
                t += T / 4
                assert np.linalg.norm(e) <= factor * np.exp(-0.1 * t) * (1 + 1e-9)


@pytest.mark.parametrize(
    "ends", [((("0.8", "-0.2"),), (("1.2", "0.2"),)), ((("0.9", 0), (0, "0.7")), ((1, 0), (0, 1)))]
)
def test_products_of_jumps_and_a_linear_flow_stay_below_the_proved_rate(ends):
    """(I - K H_v) exp(A T) over random words of corners, written out."""
    made, T = saddle(periodic("0.4"), *ends), 0.4
    K, _ = design(impulsive(made, [[0] * made.p] * 2), 1)
    asked = Question(impulsive(made, K.rows), rate=Fraction(1, 5), effort=2)
    certificate = Clock.propose(asked)
    assert certificate is not None
    factor = certificate.factor(asked)
    lower, upper = (np.array(ExactMatrix(end).floats) for end in ends)
    F, random = expm(np.array(ExactMatrix(SWING).floats) * T), np.random.default_rng(1)
    for _ in range(300):
        M = np.eye(2)
        for k in range(30):
            H = np.where(random.random(lower.shape) < 0.5, lower, upper)
            M = (np.eye(2) - K.floats @ H) @ F @ M
            assert np.linalg.norm(M, 2) <= factor * np.exp(-0.2 * T * (k + 1)) * np.exp(0.2 * T)


def test_words_of_jumps_alone_are_found_where_each_constant_jump_would_do():
    """Every constant H keeps the error small, H that alternates does not: found by the search, and by products."""
    chain = plant([[0, 1], [0, 0]], ZERO, ZERO, [[1, 0]], periodic("1.5"))
    inclusion = impulsive(seen_through(chain, [["0.6", 0]], [["1.3", 0]]), [["0.4"], ["1.1"]])
    F = np.array([[1.0, 1.5], [0.0, 1.0]])
    corners = [np.array([[1 - 0.4 * h, 0], [-1.1 * h, 1]]) @ F for h in (0.6, 1.3)]
    constant = max(np.abs(np.linalg.eigvals(M)).max() for M in corners)
    pairs = max(np.abs(np.linalg.eigvals(M @ N)).max() for M in corners for N in corners)
    assert constant < 0.9 and pairs > 1.5
    witness = refute(inclusion, 1)
    assert witness is not None and refutes(inclusion, witness)
    (*_, last) = witness.data["outputs"]
    assert len(last["values"]) > 1
    assert analyse(inclusion, 1) is None


def test_what_is_proved_for_the_middle_of_the_slopes_is_not_taken_for_all():
    made = saddle(periodic("0.8"), [["0.1", "-0.5"]], [["1.9", "0.5"]])
    middle = replace(made, H=None)
    K = [[1], [1]]
    certificate = analyse(impulsive(middle, K), 1)
    assert certificate is not None and certificate.method == "spectral_radius"
    assert not proof(impulsive(made, K), certificate).holds
    assert refute(impulsive(made, K), 1) is not None
    assert refute(impulsive(middle, K), 1) is None


def test_a_dead_beat_needs_outputs_that_are_linear():
    one = plant([["0.1"]], [[0]], [[0]], [[1]], periodic(1))
    varying = seen_through(one, [["0.9"]], [["1.1"]])
    assert resets(impulsive(one, [[1]])) and not resets(impulsive(varying, [[1]]))
    certificate = analyse(impulsive(varying, [[1]]), 1)
    assert certificate is not None and certificate.method == "clock"
    chain = plant([[0, 1], [0, 0]], ZERO, ZERO, [[1, 0]], periodic(1))
    assert EveryPeriod.propose(Question(impulsive(chain, [[0], [0]]))) is not None
    bent = seen_through(chain, [["0.9", 0]], [["1.1", 0]])
    assert EveryPeriod.propose(Question(impulsive(bent, [[0], [0]]))) is None


def test_a_plant_that_decays_by_itself_needs_no_output_at_all():
    made = seen_through(plant([[-1, 0], [0, -2]], ZERO, ZERO, [[1, 0]], periodic(1)), [[-1, 0]], [[1, 0]])
    assert OpenLoop.propose(Question(impulsive(made, [[0], [0]]))) is not None


def test_from_period_0_on_where_the_measured_direction_is_one():
    law = aperiodic(0, "0.5")
    straight = impulsive(pendulum("0.2", law), [[1], ["0.9"]])
    certificate = analyse(straight, 1)
    assert certificate is not None and proves(straight, certificate)
    assert not proves(impulsive(pendulum("0.9", law), [[1], ["0.9"]]), certificate)
    turning = seen_through(canonical([1, 0], law), [["0.9", "-0.1"]], [["1.1", "0.1"]])
    assert analyse(impulsive(turning, [[1], ["0.9"]]), 1) is None


def test_the_longest_period_shrinks_as_the_slopes_of_the_outputs_widen():
    ends = []
    for r in ("0.05", "0.1", "0.2"):
        met = longest(lambda T, r=r: impulsive(pendulum(r, periodic(T)), [[1], ["0.8"]]), "0.5", 0)
        assert met is not None
        ends.append(float(met[0]))
    assert ends[0] > ends[1] > ends[2] > 0.5


@pytest.mark.parametrize(("lower", "found"), [("-0.3", True), ("0", True), ("0.1", False)])
def test_an_output_that_may_be_flat_shows_nothing(lower, found):
    made = seen_through(plant(SWING, ZERO, ZERO, [[1, 0]], periodic(1)), [[lower, 0]], [[1, 0]])
    met = unseen(made)
    assert (met is not None) == found
    if met is not None:
        assert met.outputs == (Exact(0),) and "d y_1 / d x0 = 0" in met.sentence(made)
        inclusion = impulsive(made, [[1], [1]])
        run = replay(inclusion, met.witness(made))
        assert np.linalg.norm(run.e[-1]) > np.linalg.norm(run.e[0])
        assert refute(inclusion, 0) is not None


def test_the_held_innovation_written_over_r_and_over_w_is_one_system():
    made = saddle(periodic("0.5"))
    L = {"L": ExactMatrix([["1.2"], ["0.9"]])}
    over_r = LpvZeroOrderHold().inclusion(made, L)
    over_w = LpvZeroOrderHold().inclusion(replace(made, H=None), L)
    assert over_r.assemble(over_r.view_floats).jump_parts and not over_w.floats.jump_parts
    for maps, written in ((over_r.floats, held_maps), (over_w.floats, error_maps)):
        assert (
            maps.base.tolist()
            == written(over_r.view_floats if written is held_maps else over_w.view_floats).base.tolist()
        )
    radii = [
        np.sort(np.abs(np.linalg.eigvals(maps.jump @ expm(maps.base * 0.5))))[1:]
        for maps in (over_r.floats, over_w.floats)
    ]
    assert radii[0] == pytest.approx(radii[1])


def test_a_held_innovation_of_random_slopes_decays_as_proved():
    """The loop written out: e' = A e + L r, r = -H e at samples."""
    made, L = saddle(periodic("0.3"), [["0.9", "-0.1"]], [["1.1", "0.1"]]), np.array([[1.6], [1.5]])
    asked = Question(
        LpvZeroOrderHold().inclusion(made, {"L": ExactMatrix.from_floats(L, 3)}), rate=Fraction(1, 10), effort=2
    )
    certificate = Clock.propose(asked)
    assert certificate is not None
    factor, random = certificate.factor(asked), np.random.default_rng(2)
    A = np.array(ExactMatrix(SWING).floats)
    G = expm(np.block([[A, L], [np.zeros((1, 3))]]) * 0.3)
    for _ in range(200):
        e = random.normal(size=(2, 1))
        e /= np.linalg.norm(e)
        for k in range(60):
            H = np.array([[random.choice([0.9, 1.1]), random.choice([-0.1, 0.1])]])
            e = (G @ np.vstack([e, -H @ e]))[:2]
            assert np.linalg.norm(e) <= factor * np.exp(-0.1 * 0.3 * k)
    wider = replace(
        asked,
        inclusion=LpvZeroOrderHold().inclusion(saddle(periodic("0.3"), [[0, -1]], [[2, 1]]), asked.inclusion.gain),
    )
    assert not certificate.prove(wider).holds


def test_no_error_passes_the_transient_proved_for_all_slopes_of_the_outputs():
    law = aperiodic("0.2", "0.5")
    inclusion = Reachability().inclusion(pendulum("0.3", law), {"K": ExactMatrix([["1"], ["1.2"]])})
    asked = Question(inclusion)
    certificate = Clock.propose(asked)
    assert certificate is not None
    level = certificate.level(asked)
    assert level is not None and len(level.forms) == 2
    start = Box((Exact("-0.3"), Exact("0.1")), (Exact("0.2"), Exact("0.4")))
    bounds = np.array([float(bound) for bound in level.bounds(start)])
    maps, random, worst = inclusion.floats, np.random.default_rng(7), np.zeros(2)
    jumps, steps = list(maps.jumps()), [expm(maps.flow((v,)) * 0.05) for v in (-1.0, 1.0)]
    for _ in range(200):
        e = np.array([random.choice([-0.3, 0.2]), random.choice([0.1, 0.4])])
        for _ in range(8):
            e = jumps[random.integers(2)] @ e
            worst = np.maximum(worst, np.abs(e))
            for _ in range(random.integers(4, 11)):
                e = steps[random.integers(2)] @ e
                worst = np.maximum(worst, np.abs(e))
    assert np.all(worst <= bounds) and np.all(bounds <= 8 * worst)


def test_six_slopes_of_the_outputs_are_taken_and_seven_are_not():
    A, none = block_diag([[-1, 1], [0, -1]], [[-1, 0], [0, -2]]).tolist(), [[0] * 4] * 4
    made = plant(A, none, none, [[1, 0, 0, 0]], periodic("0.1"))
    lower, upper = [["-0.1"] * 4, ["-0.1", "-0.1", 0, 0]], [["0.1"] * 4, ["0.1", "0.1", 0, 0]]
    K = [["0.1", 0], [0, "0.1"], [0, 0], [0, 0]]
    certificate = analyse(impulsive(seen_through(made, lower, upper), K), 0)
    assert certificate is not None
    seven = [["-0.1"] * 4, ["-0.1"] * 3 + [0]], [["0.1"] * 4, ["0.1"] * 3 + [0]]
    assert not proves(impulsive(seen_through(made, *seven), K), certificate)


@pytest.mark.parametrize(("low", "high", "holds"), [("0.9", "1.1", True), ("0.4", "1.1", False), ("0.9", "1.6", False)])
def test_every_corner_of_the_jump_counts(low, high, holds):
    """A certificate for slopes in [0.9, 1.1] against a class that goes further on one side only."""
    law = periodic("1.2")
    K = [[1], ["0.85"]]
    certificate = analyse(impulsive(pendulum("0.1", law), K), 1)
    assert certificate is not None
    about = impulsive(seen_through(canonical([1, 0], law), [[low, 0]], [[high, 0]]), K)
    assert proves(about, certificate) == holds
    assert (refute(about, 1) is None) == holds
