"""The width of the bounds from sample to sample, where E(s) >= 0 is not known: does its map contract?

    w(t_k + s) = E_w(s) w(t_k) + Gamma_w(s) c,    E_w(s) = I + s Phi(s),    Phi(s) = phi_1((P + N) s) Mtot

w obeys this whether or not the bounds enclose the state. Where E_w contracts under the law, w settles at
(-Mtot)^-1 c, the fixed point of every E_w(s): for constant bounds exactly there.
"""

from __future__ import annotations

from flint import arb

from cdobs_cli.certificate import Witness
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.families.interval.held import contracts, growing_period, growth_and_slope
from cdobs_cli.families.interval.parts import absolute
from cdobs_cli.families.interval.system import System
from cdobs_cli.families.interval.theorems import width_flow
from cdobs_cli.sampling import SamplingLaw


def width_growth(Q0: Matrix, Mtot: Matrix, s: arb) -> tuple[Matrix, Matrix]:
    """Phi(s) and Phi'(s) with E_w(s) = I + s Phi(s)."""
    return growth_and_slope(width_flow(Q0), Mtot, s)


def width_contracts(system: System, w_star: Matrix, law: SamplingLaw) -> bool:
    """Whether w* > 0 and |E_w(s)| w* <= (1 - rate s) w*, rate > 0, is proved for every period s of the law."""
    return w_star.shape == (system.n, 1) and contracts(lambda s: width_growth(system.z.Q0, system.Mtot, s), w_star, law)


def refute_width(system: System, law: SamplingLaw) -> Witness | None:
    """A constant period of the law at which widths grow for ever: rho(E_w(T)) > 1, proved. The widths |S| a that boxes
    of x(0) start have to span all directions, so that one of them grows."""
    if arb(absolute(system.z.S).balls().data.det()).contains(0):
        return None
    return growing_period(law, lambda s: Matrix.identity(system.n) + width_growth(system.z.Q0, system.Mtot, s)[0] * s)
