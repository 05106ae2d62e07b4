"""The inequalities of sensors that send on change, each one pure function, and when messages do not let V grow.

Sensor i sends when r_i = y_i - C_i x_hat, which is v_i - C_i e, reaches delta_i: e+ = e + K_i r_i. If P K_i = l_i C_i'
with l_i > 0, and c_i = C_i K_i, then

    e+'P e+ - e'P e = 2 r l C_i e + r^2 l c = -l_i ((2 - c_i) r_i^2 - 2 r_i v_i),

which for |r_i| >= delta_i and |v_i| <= vbar_i is at most -l_i delta_i ((2 - c_i) delta_i - 2 vbar_i): below 0 where
(2 - c_i) delta_i > 2 vbar_i. Conversely, without noise J'P J <= P for J = I - K_i C_i says P K_i = l_i C_i': J keeps
the kernel of C_i, on which P - J'P J is 0. The equation is one between rationals, and proved as that.
"""

from __future__ import annotations

from typing import Any

from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.peak.signals import acting, acting_sizes
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.plant import Plant
from cdobs_cli.records import dataclass


@dataclass(frozen=True)
class Setting:
    """The error system of a question whose sensors send on change.

    C (p, n), K (n, p); of each sensor delta, vbar and their sum; E (n, q) and d0 (q,): how the disturbances that are
    not 0 act, and how large they are. Rational where the data are rational, balls otherwise.
    """

    corners: list[Matrix]
    C: Matrix
    K: Matrix
    delta: tuple[Any, ...]
    vbar: tuple[Any, ...]
    E: Matrix
    d0: tuple[Any, ...]

    @staticmethod
    def of(question: Question) -> Setting:
        inclusion, plant = question.inclusion, question.plant
        view, d = inclusion.view_balls, acting(plant.disturbance)
        E = inclusion.noise_balls.drive[:, d] if d else Matrix.zeros(plant.n, 0)
        corners, d0 = list(inclusion.balls.corners()), acting_sizes(plant.disturbance)
        return Setting(corners, view.C, view.gain["K"], deltas(plant), noise_sizes(plant), E, d0)

    @property
    def reach(self) -> tuple[Any, ...]:
        """|C_i e| <= delta_i + vbar_i whenever no sensor sends."""
        return tuple(delta + v for delta, v in zip(self.delta, self.vbar, strict=True))


def deltas(plant: Plant) -> tuple[Any, ...]:
    """The threshold of each output."""
    return tuple(one.delta.scalar for one in plant.sampling.thresholds)


def noise_sizes(plant: Plant) -> tuple[Any, ...]:
    """How large the noise of each output is at most."""
    return (0,) * plant.p if plant.noise is None else plant.noise.sizes


def flow_gap(S: Any, Q: Any, PE: Any, Gamma: Any) -> Any:
    """[[Q - S, -P E], [., Gamma]] with S = Pdot + P A + A'P + 2 sigma P and Q = sum mu_i C_i'C_i: where it is >= 0,
    Vdot <= -2 sigma V + sum mu_i (C_i e)^2 + sum gamma_k d_k^2."""
    if not PE.shape[1]:
        return Q - S
    return block([[Q - S, -PE], [-PE.T, Gamma]])


def weighted_outputs(C: Any, M: Any) -> Any:
    """sum mu_i C_i'C_i, M = diag(mu)."""
    return C.T @ M @ C


def silent_gap(P_0: Any, P_h: Any, Q: Any) -> Any:
    """P(h) + Q - P(0): where it is >= 0, V rises by sum mu_i (C_i e)^2 at most from before a check, at which no sensor
    has (more) to send, to after it."""
    return P_h + Q - P_0


def factors(P: Matrix, setting: Setting) -> list[Any] | None:
    """The l_i > 0 of P K_i = l_i C_i' where these hold exactly and no message lets V grow; None otherwise."""
    C, K = setting.C, setting.K
    if not (P.is_rational and C.is_rational and K.is_rational):
        return None
    PK, CK, found = P @ K, C @ K, []
    for i in range(C.shape[0]):
        row = [C[i, j] for j in range(C.shape[1])]
        j = next((j for j, value in enumerate(row) if value != 0), None)
        if j is None:
            return None
        factor = PK[j, i] / row[j]
        if any(PK[k, i] != factor * value for k, value in enumerate(row)):
            return None
        if not factor > 0 or not drop(CK[i, i], setting.delta[i], setting.vbar[i]) > 0:
            return None
        found.append(factor)
    return found


def drop(c: Any, delta: Any, vbar: Any) -> Any:
    """delta ((2 - c) delta - 2 vbar): what a message takes from V at least, over l."""
    return delta * ((2 - c) * delta - 2 * vbar)
