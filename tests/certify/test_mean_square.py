"""Mean square bounds: against the Kalman filter where slopes are constant, and what must not be proved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from example_inclusions import periodic
from noisy_inclusions import Q, R, corrected, double_integrator, kalman, pendulum, white

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.certificate import design_impulsive
from cdobs_cli.certify.methods.clock.design import ImpulsiveGain
from cdobs_cli.certify.methods.mean_square.average import Average
from cdobs_cli.certify.methods.mean_square.design import fastest_rate
from cdobs_cli.certify.methods.mean_square.every_time import EveryTime
from cdobs_cli.exact.numbers import Exact, ExactMatrix

INTEGRATOR = np.array([[0.0, 1.0], [0.0, 0.0]])


def average(inclusion, effort=1):
    question = Question(inclusion, effort=effort)
    method = Average.propose(question)
    assert method is not None
    return float(method.prove(question).error)


# noise.md prints a polynomial's values, up to 4e-6 above the filter's own.
@pytest.mark.parametrize(
    ("T", "printed"), [("0.1", 1.350840e-4), ("0.3", 1.982158e-4), ("0.6", 2.746352e-4), ("1.2", 4.615728e-4)]
)
def test_without_slopes_the_average_is_that_of_the_kalman_filter(T, printed):
    K, best, worst = kalman(INTEGRATOR, np.array([[1.0, 0.0]]), np.diag([0, 2.5e-4]), np.array([[1e-4 / 3]]), float(T))
    assert best == pytest.approx(printed, rel=5e-6)
    about = corrected(double_integrator(T), ExactMatrix.from_floats(K, 8).rows)
    bound = average(about) ** 2
    assert 1 - 1e-9 <= bound / best <= 1 + 1e-5
    question = Question(about)
    for one in EveryTime.each(question):
        at_worst = float(one.prove(question).error) ** 2 / worst[int(one.state)]
        assert 1 - 1e-9 <= at_worst <= 1.08


def shrunk(rows, by):
    return [[[str(Exact(value) * Exact(by)) for value in row] for row in one] for one in rows]


def test_a_certificate_with_a_smaller_p_proves_nothing():
    question = Question(corrected(white(pendulum(periodic("0.6")), R, Q), [["0.8545"], ["1.1984"]]))
    whole = Average.propose(question)
    assert whole is not None and whole.prove(question).holds
    for changed in (
        replace(whole, P=shrunk(whole.P, "0.99")), replace(whole, P=[whole.P[0], *shrunk(whole.P[1:], "0.9")]),
        replace(whole, P=whole.P[:-1]), replace(whole, shape=["4", "5", "1", "0"]), replace(whole, units=["1"]),
        replace(whole, shape=["4", "5", "0", "4"]), replace(whole, units=["-1", "1"]),
        replace(whole, law=periodic("1")),
    ):  # fmt: skip
        assert not changed.prove(question).holds
    chain = EveryTime.propose(question.of_state(1))
    assert chain is not None and chain.prove(question).holds
    P = chain.P
    for altered in (
        replace(chain, P=[[shrunk(P[0][0], "0.99"), *P[0][1:]], *P[1:]]), replace(chain, P=P[:-1]),
        replace(chain, P=[[*P[0][:-1], shrunk(P[0][-1], "0.99")], *P[1:]]), replace(chain, rho="0.1"),
        replace(chain, rho="1"), replace(chain, rho="-0.9"), replace(chain, windows=["2", "2"]),
        replace(chain, windows=["1", "1"]), replace(chain, windows=["0", "2"]), replace(chain, state="2"),
        replace(chain, windows=[]), replace(chain, P=[[P[0][0]], *P[1:]]),
    ):  # fmt: skip
        assert not altered.prove(question).holds


# A gain for these periods is (0.36, 0.80) .. (0.98, 0.97); noise.md prints its proved root mean square.
@pytest.mark.parametrize(("T", "rms"), [("0.1", 0.01268), ("0.6", 0.02116), ("1.2", 0.03885)])
def test_the_gain_of_least_error_of_the_pendulum(T, rms):
    question = Question(corrected(white(pendulum(periodic(T)), R, Q), [[0], [0]]))
    met = ImpulsiveGain().least_error(question, weights=[1, 1])
    assert met is not None and met.method is not None
    about = question.with_gain({"K": met.gain})
    assert met.method.prove(about).holds
    proved = float(Average.propose(about).prove(about).error)
    assert proved <= rms and proved == pytest.approx(-met.merit, rel=1e-6)
    # Gains near by are no better.
    for step in ([0.01, 0], [0, 0.02], [-0.01, 0.01]):
        other = ExactMatrix.from_floats(met.gain.floats + np.array(step)[:, None], 6)
        assert average(question.with_gain({"K": other}).inclusion) > proved


@pytest.mark.parametrize("T", ["0.1", "0.6", "1.2"])
def test_the_quietest_gain_keeps_half_of_the_fastest_rate(T):
    question = Question(corrected(pendulum(periodic(T)), [[0], [0]]))
    met = ImpulsiveGain().quietest(question)
    assert met is not None
    about = question.with_gain({"K": met.gain})
    rate = met.method.prove(about).rate
    assert rate >= 0.49 * float(fastest_rate(question))
    loud = design_impulsive(question.with_rate(fastest_rate(question)))
    assert loud is not None
    quiet_noise, loud_noise = (
        average(corrected(white(pendulum(periodic(T)), [[1]]), gain.rows)) for gain in (met.gain, loud[0])
    )
    assert quiet_noise < loud_noise
