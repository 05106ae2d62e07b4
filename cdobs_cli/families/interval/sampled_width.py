"""The width of the bounds from sample to sample, where E(s) >= 0 is not known: does its map contract?

    w(t_k + s) = E_w(s) w(t_k) + Gamma_w(s) c,    E_w(s) = I + s Phi(s),    Phi(s) = phi_1((P + N) s) Mtot

w obeys this whether or not the bounds enclose the state. Where E_w contracts under the law, w settles at
(-Mtot)^-1 c, the fixed point of every E_w(s): for constant bounds exactly there.
"""

from __future__ import annotations

from flint import arb

from cdobs_cli.certificate import Witness
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import lower_text
from cdobs_cli.families.interval.held_loop import growth, holds_on, law_ends
from cdobs_cli.families.interval.hull import contraction
from cdobs_cli.families.interval.parts import absolute, metzler_split
from cdobs_cli.families.interval.theorems import Coordinates
from cdobs_cli.sampling import SamplingLaw

_PIECES = 512


def width_growth(Q0: Matrix, Mtot: Matrix, s: arb) -> Matrix:
    """Phi(s) with E_w(s) = I + s Phi(s)."""
    P, N = metzler_split(Q0)
    return growth(P + N, Mtot, s)


def width_contracts(Q0: Matrix, Mtot: Matrix, w_star: Matrix, law: SamplingLaw, effort: int = 1) -> bool:
    """Whether w* > 0 and |E_w(s)| w* <= (1 - rate s) w*, rate > 0, is proved for every period s of the law."""
    if w_star.shape != (Q0.shape[0], 1) or not all(arb(w_star[i, 0]) > 0 for i in range(w_star.shape[0])):
        return False
    low, high = law_ends(law)
    falls = lambda s: all(value > 0 for value in contraction(width_growth(Q0, Mtot, s), w_star, s))  # noqa: E731
    return holds_on(falls, low, high, _PIECES * 2**effort)


def refute_width(z: Coordinates[Matrix], Mtot: Matrix, law: SamplingLaw) -> Witness | None:
    """A constant period of the law at which widths grow for ever: rho(E_w(T)) > 1, proved. The widths |S| a that boxes
    of x(0) start have to span all directions, so that one of them grows."""
    from cdobs_cli.certify.ball import spectral_radius_lower

    if arb(absolute(z.S).balls().data.det()).contains(0):
        return None
    for T in (law.T_max, law.T_min):
        if T.sign() != 1:
            continue
        s = T.ball()
        multiplier = spectral_radius_lower(Matrix.identity(Mtot.shape[0]) + width_growth(z.Q0, Mtot, s) * s)
        if multiplier > 1:
            return Witness("constant", "plant", (str(T),), ((),), lower_text(multiplier), data={"arcs": [1]})
    return None
