"""Mean square bounds: against the Kalman filter where slopes are constant, and what must not be proved."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from example_inclusions import aperiodic, periodic, plant
from noisy_inclusions import (
    Q,
    R,
    bounded,
    corrected,
    double_integrator,
    held_error,
    kalman,
    linear_moments,
    pendulum,
    random_plant,
    white,
)
from test_output_slopes import seen_through

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.methods.base import Question, read
from cdobs_cli.certify.methods.clock.form import Shape
from cdobs_cli.certify.methods.mean_square.average import Average
from cdobs_cli.certify.methods.mean_square.every_time import EveryTime
from cdobs_cli.certify.methods.mean_square.from_zero import MeanSquareFromZero
from cdobs_cli.certify.methods.mean_square.power import PowerGain
from cdobs_cli.certify.methods.mean_square.windows import windows
from cdobs_cli.exact.numbers import Exact, ExactMatrix

INTEGRATOR = np.array([[0.0, 1.0], [0.0, 0.0]])
GAIN = [["0.8545"], ["1.1984"]]


def average(inclusion, effort=1):
    question = Question(inclusion, effort=effort)
    method = Average.propose(question)
    assert method is not None
    return float(method.prove(question).error)


def at_worst(inclusion, state, effort=1):
    question = Question(inclusion, effort=effort, state=state)
    method = EveryTime.propose(question)
    assert method is not None and method.quantity(question.plant) == f"rms.x{state}"
    return float(method.prove(question).error)


def swinging(law="0.6", R=R, Q=Q, c=1, K=GAIN):
    return corrected(white(pendulum(periodic(law), c), R, Q), K)


# noise.md prints a polynomial's values, up to 4e-6 above the filter's own.
@pytest.mark.parametrize(
    ("T", "printed"), [("0.1", 1.350840e-4), ("0.3", 1.982158e-4), ("0.6", 2.746352e-4), ("1.2", 4.615728e-4)]
)
def test_without_slopes_the_average_is_that_of_the_kalman_filter(T, printed):
    K, best, worst = kalman(INTEGRATOR, np.array([[1.0, 0.0]]), np.diag([0, 2.5e-4]), np.array([[1e-4 / 3]]), float(T))
    assert best == pytest.approx(printed, rel=5e-6)
    about = corrected(double_integrator(T), ExactMatrix.from_floats(K, 8).rows)
    assert 1 - 1e-9 <= average(about) ** 2 / best <= 1 + 1e-5
    for state in (0, 1):
        assert 1 - 1e-9 <= at_worst(about, state) ** 2 / worst[state] <= 1.06


@pytest.mark.parametrize(("seed", "n", "p"), [(1, 2, 1), (2, 2, 2), (3, 3, 1), (4, 3, 2), (5, 4, 1), (6, 4, 2)])
def test_random_linear_errors_have_the_moments_that_are_proved(seed, n, p):
    made, A, C, Q, R = random_plant(seed, n, p, "0.2")
    K, best, worst = kalman(A, C, Q, R, 0.2)
    about = corrected(made, ExactMatrix.from_floats(K, 8).rows)
    assert 1 - 1e-9 <= average(about, 2) ** 2 / best <= 1 + 1e-5
    assert 1 - 1e-9 <= at_worst(about, n - 1) ** 2 / worst[n - 1] <= 1.45


def test_a_held_linear_error_has_the_moments_that_are_proved():
    about = held_error(double_integrator("0.3"), [["2.5"], ["3"]])
    mean, worst = linear_moments(about)
    assert 1 - 1e-9 <= average(about) ** 2 / mean <= 1 + 1e-5
    for state in (0, 1):
        assert 1 - 1e-9 <= at_worst(about, state) ** 2 / worst[state] <= 1.1


def test_slopes_that_depend_on_the_error_are_counted():
    """e1' = V e2 with |V| <= 1 from e ~ N(0, 2 I): a covariance that grows with each corner of the slopes says
    E e1(1)^2 <= 4.13, and V = sign(e1 e2) gives 4 + 8/pi, rare shocks along (1, 1), (1, -1) up to 8."""
    none = [[0, 0], [0, 0]]
    free = white(plant(none, [[0, -1], [0, 0]], [[0, 1], [0, 0]], [[1, 0], [0, 1]], periodic(1)), [[2, 0], [0, 2]])
    about = corrected(free, [[1, 0], [0, 1]])
    assert 8 <= at_worst(about, 0, 2) ** 2 <= 8.01
    # Over time: e1^2 is at most (|e1(0)| + tau |e2|)^2, 2 (1 + tau)^2 for the same shocks; e2^2 stays 2.
    assert 2 * 7 / 3 + 2 <= average(about, 2) ** 2 <= 2 * 7 / 3 + 2.01


def test_periods_that_depend_on_the_error_are_counted_in_the_average():
    """e+ = v, then constant: longest after v != 0, which is rare, the average is R T_max / T_min."""
    made = white(plant([[0]], [[0]], [[0]], [[1]], aperiodic("0.5", "1")), [[1]])
    assert 2 <= average(corrected(made, [[1]])) ** 2 <= 2.0001
    # At every time the periods must not depend on it: then it is R.
    assert 1 <= at_worst(corrected(made, [[1]]), 0) ** 2 <= 1.0001
    assert "do not depend on" in EveryTime.statement


@pytest.mark.parametrize("law", [periodic("0.6"), aperiodic("0.2", "0.6")])
def test_no_bang_bang_member_leaves_the_bounds(law):
    """V = sign(e1 e2) and its mirror: the error's own feedback."""
    about = corrected(white(pendulum(law), R, Q), GAIN)
    random, h = np.random.default_rng(0), 0.01
    rms, worst = average(about), [at_worst(about, state) for state in (0, 1)]
    J, K = about.floats.jump, np.array([[0.8545], [1.1984]])
    for sign in (1.0, -1.0):
        e, sums, moments, steps = np.zeros((2, 800)), 0.0, np.zeros(2), 0
        for k in range(60):
            T = 0.6 if law.is_periodic else random.choice([0.2, 0.4, 0.6])
            e = J @ e + K * np.sqrt(1e-4 / 3) * random.normal(size=800)
            for _ in range(round(T / h)):
                V = sign * np.sign(e[0] * e[1])
                e = e + h * np.stack([e[1], V * e[0]])
                e[1] += np.sqrt(2.5e-4 * h) * random.normal(size=800)
                if k > 10:
                    squares = np.mean(e**2, axis=1)
                    sums, steps, moments = sums + squares.sum(), steps + 1, np.maximum(moments, squares)
        assert np.sqrt(sums / steps) < rms
        assert np.all(np.sqrt(moments) < 1.05 * np.array(worst))  # 800 runs: the largest of many averages


def test_bounds_scale_with_the_noise_and_grow_with_what_is_declared():
    plain, every = average(swinging()), at_worst(swinging(), 1)
    four = [["4/30000"]], [[0, 0], [0, "0.001"]]
    assert average(swinging(R=four[0], Q=four[1])) == pytest.approx(2 * plain, rel=1e-5)
    assert at_worst(swinging(R=four[0], Q=four[1]), 1) == pytest.approx(2 * every, rel=1e-4)
    for more in (swinging(R=four[0]), swinging(Q=four[1]), swinging(c="1.2")):
        assert average(more) > plain and at_worst(more, 1) > every
    for less in (swinging(R=None), swinging(Q=None), swinging(c="0.5")):
        assert average(less) < plain and at_worst(less, 1) < every
    # The parts of noise and disturbance add up, at least in squares.
    assert average(swinging(Q=None)) ** 2 + average(swinging(R=None)) ** 2 <= plain**2 * (1 + 1e-6)
    wider = [corrected(white(pendulum(aperiodic(low, "0.6")), R, Q), GAIN) for low in ("0.5", "0.3")]
    assert plain <= average(wider[0]) <= average(wider[1])


def test_time_and_states_in_other_units_change_nothing():
    """t = 100 s, e = (1000, 10) z: T, A, C, R, Q and K in those units."""
    made = plant([[0, 1], [0, 0]], [[0, 0], ["-1e-4", 0]], [[0, 0], ["1e-4", 0]], [["1e-3", 0]], periodic("60"))
    slow = white(made, R, [[0, 0], [0, "0.00025"]])
    # x_1 = 1000 z_1, x_2 = dx_1/dt = 10 dz_1/ds: intensity 10^2 / 100 of that per unit s.
    about = corrected(slow, [["854.5"], ["11.984"]])
    assert at_worst(about, 0) == pytest.approx(1000 * at_worst(swinging(), 0), rel=1e-3)
    assert at_worst(about, 1) == pytest.approx(10 * at_worst(swinging(), 1), rel=1e-3)


@pytest.mark.parametrize("state", [None, 0])
def test_outputs_whose_slopes_vary_are_taken_at_every_corner(state):
    law = periodic("0.5")
    middle = white(pendulum(law), R, Q)
    near, far = (seen_through(middle, [[low, 0]], [[high, 0]]) for low, high in (("0.95", "1.05"), ("0.8", "1.2")))
    kind, questions = (
        Average if state is None else EveryTime,
        [Question(corrected(one, GAIN), state=state) for one in (middle, near, far)],
    )
    proposals = [kind.propose(question) for question in questions]
    errors = [float(one.prove(question).error) for one, question in zip(proposals, questions, strict=True)]
    assert errors[0] < errors[1] < errors[2]
    assert proposals[2].prove(questions[1]).holds and not proposals[1].prove(questions[2]).holds


def shrunk(rows, by):
    return [[[str(Exact(value) * Exact(by)) for value in row] for row in one] for one in rows]


def test_a_certificate_with_a_smaller_p_proves_nothing():
    question = Question(swinging())
    whole = Average.propose(question)
    assert whole is not None and whole.prove(question).holds
    for changed in (
        replace(whole, P=shrunk(whole.P, "0.99")), replace(whole, P=[whole.P[0], *shrunk(whole.P[1:], "0.9")]),
        replace(whole, P=whole.P[:-1]), replace(whole, shape=["4", "5", "1", "0"]), replace(whole, units=["1"]),
        replace(whole, P=[*whole.P, whole.P[-1]]), replace(whole, shape=["4", "99", "4", "0"]),
        replace(whole, shape=["4", "5", "0", "4"]), replace(whole, units=["-1", "1"]),
        replace(whole, law=periodic("1")), replace(whole, P=[["x"]]), replace(whole, shape=["a"]),
    ):  # fmt: skip
        assert not changed.prove(question).holds
    assert not whole.prove(Question(swinging(c="1.1"))).holds
    assert not whole.prove(Question(swinging(K=[["0.8"], ["1.3"]]))).holds
    # P does not depend on the noise: the bound follows what is declared.
    louder = whole.prove(Question(swinging(R=[["1/300"]])))
    assert louder.holds and louder.error > 3 * whole.prove(question).error


def test_a_chain_with_a_smaller_p_proves_nothing():
    question = Question(swinging(), state=1)
    chain = EveryTime.propose(question)
    assert chain is not None and chain.prove(question).holds
    P = chain.P
    for altered in (
        replace(chain, P=[[shrunk(P[0][0], "0.99"), *P[0][1:]], *P[1:]]), replace(chain, P=P[:-1]),
        replace(chain, P=[[*P[0][:-1], shrunk(P[0][-1], "0.99")], *P[1:]]), replace(chain, rho="0.1"),
        replace(chain, P=[[P[0][0], shrunk(P[0][1], "0.99"), *P[0][2:]], *P[1:]]), replace(chain, rho="1"),
        replace(chain, rho="-0.9"), replace(chain, rho="1.5"), replace(chain, windows=["2", "2"]),
        replace(chain, windows=["1", "1"]),
        replace(chain, windows=["0", "2"]), replace(chain, windows=["3", "2"]), replace(chain, state="2"),
        replace(chain, windows=[]), replace(chain, windows=[], P=[]), replace(chain, P=[[P[0][0]], *P[1:]]),
        replace(chain, state="0"), replace(chain, windows=["1.5", "2", *chain.windows[2:]]),
    ):  # fmt: skip
        assert not altered.prove(question).holds
    assert not chain.prove(Question(swinging(c="1.1"))).holds
    # P_0 that grows within its window lies above z z', and does not fall along the flow.
    d = int(chain.shape[0])
    grown = [P[0][0][:1] + shrunk(P[0][0][1 : d + 1], "1.5") + P[0][0][d + 1 :], *P[0][1:]]
    assert chain.windows[0] == "1" and not replace(chain, P=[grown, *P[1:]]).prove(question).holds


def test_windows_are_parts_of_pieces_one_behind_the_other():
    form = Shape(4, 5, 2, 0)
    assert [one.piece for one in windows(form, ["0.5", "1", "7/4", "2"])] == [0, 0, 1, 1]
    for ends in (["1.5", "2"], ["1"], ["1", "2", "3"], ["1", "1", "2"], []):
        with pytest.raises(ValueError, match="windows"):
            windows(form, ends)


def test_every_corner_counts():
    """A certificate of a class against one that goes further on one side only."""
    law = periodic("0.6")
    for kind, state in ((Average, None), (EveryTime, 1)):
        proof = kind.propose(Question(swinging(), state=state))
        for low, high in ((-1, "1.2"), ("-1.2", 1)):
            wider = plant([[0, 1], [0, 0]], [[0, 0], [low, 0]], [[0, 0], [high, 0]], [[1, 0]], law)
            assert not proof.prove(Question(corrected(white(wider, R, Q), GAIN), state=state)).holds
        near = Question(
            corrected(seen_through(white(pendulum(law), R, Q), [["0.9", 0]], [["1.1", 0]]), GAIN), state=state
        )
        proof = kind.propose(near)
        for low, high in (("0.9", "1.5"), ("0.5", "1.1")):
            far = seen_through(white(pendulum(law), R, Q), [[low, 0]], [[high, 0]])
            assert proof.prove(near).holds and not proof.prove(Question(corrected(far, GAIN), state=state)).holds


def test_every_period_counts():
    """An oscillator is not seen at half its period, 0.45: what is proved every 0.6 is not at periods in [0.3, 0.6]."""
    none, A = [[0, 0], [0, 0]], [[0, 1], ["-48.7", 0]]
    made = white(plant(A, none, none, [[1, 0]], periodic("0.6")), [[1]], [[0, 0], [0, 1]])
    question = Question(corrected(made, [["0.3"], ["-1"]]), effort=2)
    proof = Average.propose(question)
    assert proof is not None and proof.prove(question).holds and proof.shape[2:] == ["6", "0"]
    apart = replace(proof, law=aperiodic("0.3", "0.6"), shape=[*proof.shape[:2], "3", "3"])
    assert not apart.prove(question).holds


@pytest.mark.parametrize(
    ("kind", "made"),
    [
        (Average, white(pendulum(periodic("0.6")), R, Q)), (EveryTime, white(pendulum(periodic("0.6")), R, Q)),
        (PowerGain, bounded(pendulum(periodic("0.6")), ["0.01"], [0, "0.05"])),
    ],
)  # fmt: skip
def test_what_is_stored_reads_back_and_proves_the_same(kind, made):
    question = Question(corrected(made, GAIN), state=1 if kind is EveryTime else None)
    method = kind.propose(question)
    assert method is not None and method.reach == "mean square"
    document = json.loads(json.dumps(method.certificate().document()))
    again = read(Certificate.from_document(document), (Average, EveryTime, PowerGain))
    assert again is not None and again.method == method
    assert again.method.prove(question).error == method.prove(question).error


def test_what_is_not_white_is_not_bounded_in_mean_square():
    """Nothing declared, bounded signals alone, and samples without a least distance."""
    proof = Average.propose(Question(swinging()))
    for one in (pendulum(periodic("0.6")), bounded(pendulum(periodic("0.6")), ["0.01"])):
        question = Question(corrected(one, GAIN))
        assert Average.propose(question) is None and not proof.prove(question).holds
        assert EveryTime.propose(question.of_state(0)) is None
    from_zero = Question(corrected(white(pendulum(aperiodic(0, "0.6")), R, Q), [[1], ["1.4"]]))
    assert Average.propose(from_zero) is None and EveryTime.propose(from_zero.of_state(0)) is None
    assert PowerGain.propose(from_zero) is None
    for one in (swinging(), corrected(bounded(pendulum(aperiodic(0, "0.6")), ["0.01"]), GAIN)):
        assert MeanSquareFromZero.propose(Question(one, state=0)) is None


@pytest.mark.parametrize("bounded_noise", [False, True])
def test_a_bounded_signal_beside_a_white_one_adds_at_most_its_own_error(bounded_noise):
    base = pendulum(periodic("0.6"))
    noise, disturbance = bounded(base, ["0.01"]).noise, bounded(base, None, [0, "0.05"]).disturbance
    if bounded_noise:
        mixed, alone = replace(white(base, None, Q), noise=noise), swinging(R=None)
    else:
        mixed, alone = replace(white(base, R), disturbance=disturbance), swinging(Q=None)
    question = Question(corrected(mixed, GAIN))
    assert Average.propose(question) is None and not Average.propose(Question(alone)).prove(question).holds
    power = PowerGain.propose(question)
    only = replace(mixed, covariance=None, intensity=None)
    part = float(PowerGain.propose(Question(corrected(only, GAIN))).prove(Question(corrected(only, GAIN))).error)
    assert max(average(alone), part) < float(power.prove(question).error) < average(alone) + part
    for state in (0, 1):
        chain, about = EveryTime.propose(question.of_state(state)), question.of_state(state)
        assert at_worst(alone, state) < float(chain.prove(about).error)
        for signal in ("mu", "nu"):
            cheap = json.loads(json.dumps(getattr(chain, signal)).replace('"0.', '"0.0'))
            assert cheap == getattr(chain, signal) or not replace(chain, **{signal: cheap}).prove(about).holds
        assert not replace(chain, mu=None, nu=None).prove(about).holds
    assert not EveryTime.propose(Question(alone, state=0)).prove(question).holds
    # A white signal that is next to nothing leaves what the bounded ones do: noise.md prints 0.0560, 0.1018.
    tiny = replace(white(base, [["1e-12"]]), noise=noise, disturbance=disturbance)
    assert at_worst(corrected(tiny, [[1], ["1.47478"]]), 1) == pytest.approx(0.1018, abs=1e-4)


def test_the_power_of_bounded_signals():
    """e' = -e + d: the gain from d is 1 (d constant). e+ = 0.7 e + 0.3 v every half: v constant is its own error."""
    slow = Question(corrected(bounded(plant([[-1]], [[0]], [[0]], [[1]], periodic(1)), None, [1]), [[0]]))
    kicked = Question(corrected(bounded(plant([[0]], [[0]], [[0]], [[1]], periodic("0.5")), [1]), [["0.3"]]))
    for question in (slow, kicked):
        method = PowerGain.propose(question)
        assert method is not None and 1 <= float(method.prove(question).error) <= 1.00001
        assert method.quantity(question.plant) == "rms"
    price = PowerGain.propose(slow)
    assert not replace(price, g=["0.999"]).prove(slow).holds and not replace(price, g=[]).prove(slow).holds
    assert not replace(PowerGain.propose(kicked), nu=["0.4999"]).prove(kicked).holds


@pytest.mark.parametrize("law", [periodic("0.3"), aperiodic("0.1", "0.3")])
def test_no_bounded_signal_has_more_power(law):
    about = corrected(bounded(pendulum(law), ["0.01"], [0, "0.05"]), [["0.8777"], ["1.6234"]])
    question = Question(about)
    bound = float(PowerGain.propose(question).prove(question).error)
    random, h = np.random.default_rng(0), 0.01
    J, K = about.floats.jump, np.array([[0.8777], [1.6234]])
    for slow in (1, 5, 50):  # samples between changes of sign
        e, total, time, most = np.zeros((2, 200)), 0.0, 0.0, 0.0
        for k in range(300):
            if k % slow == 0:
                v, d, V = (random.choice([-1.0, 1.0], size=200) for _ in range(3))
            e = J @ e + K * 0.01 * v
            for _ in range(round((0.3 if law.is_periodic else random.choice([0.1, 0.3])) / h)):
                e = e + h * np.stack([e[1], V * e[0] + 0.05 * d])
                total, time = total + h * np.sum(e**2, axis=0), time + h
        most = max(most, float(np.sqrt(np.max(total / time))))
        assert most < bound


@pytest.mark.parametrize(
    ("make", "gain"), [(corrected, [[1], ["1.2"]]), (corrected, [["0.8"], ["1.2"]]), (held_error, [["2.5"], ["3"]])]
)
def test_samples_without_a_least_distance(make, gain):
    """Of a correction that erases what it measures, of one that keeps a part of old noise, and of a hold."""
    law = aperiodic(0, "0.4")
    questions = [Question(make(white(pendulum(law), *one), gain), state=1) for one in ((R, Q), (R, None), (None, Q))]
    met = [MeanSquareFromZero.propose(question) for question in questions]
    both, noise, drift = (float(one.prove(question).error) for one, question in zip(met, questions, strict=True))
    assert max(noise, drift) < both < 1.5 * (noise + drift)
    assert met[0].quantity(questions[0].plant) == "rms.x1" and "do not depend" in met[0].since(questions[0].plant)
    wider = Question(make(white(pendulum(law, 2), R, Q), gain), state=1)
    louder = Question(make(white(pendulum(law), [["4/30000"]], Q), gain), state=1)
    assert not met[0].prove(wider).holds and met[0].prove(louder).error > met[0].prove(questions[0]).error
    for changed in ({"mu": shrunk([met[0].mu], "0.1")[0]}, {"P": shrunk(met[0].P, "0.9")}, {"sigma": "9"}, {"mu": []}):
        assert not replace(met[0], **changed).prove(questions[0]).holds
    # Bang-bang slopes against the error, periods near 0 and the longest.
    random, h, maps, G = (
        np.random.default_rng(0),
        0.01,
        questions[0].inclusion.floats,
        questions[0].inclusion.noise_floats,
    )
    e, most = np.zeros((len(maps.base), 600)), 0.0
    for _ in range(100):
        e = maps.jump @ e + G.kick * np.sqrt(1e-4 / 3) * random.normal(size=600)
        for _ in range(random.choice([1, 3, 40])):
            V = np.sign(e[0] * e[1])
            low, high = (maps.flow((v,)) @ e for v in (-1.0, 1.0))
            e = e + h * np.where(V > 0, high, low)
            e = e + np.outer(G.drive[:, 1], np.sqrt(2.5e-4 * h) * random.normal(size=600))
            most = max(most, float(np.mean(e[1] ** 2)))
    assert np.sqrt(most) < both < 8 * np.sqrt(most)


def test_a_bound_from_zero_is_stored_and_read():
    question = Question(corrected(white(pendulum(aperiodic(0, "0.4")), R, Q), [[1], ["1.2"]]), state=0)
    method = MeanSquareFromZero.propose(question)
    document = json.loads(json.dumps(method.certificate().document()))
    again = read(Certificate.from_document(document), (MeanSquareFromZero,))
    assert again.method == method and again.method.prove(question).error == method.prove(question).error
