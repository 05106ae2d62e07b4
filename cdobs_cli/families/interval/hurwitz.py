"""Whether the width of the bounds stays bounded, and what it settles at.

The width w = z_upper - z_lower obeys w' = (P + N) w + |Q1| w(t_k) + c with c the width of delta. While the
bounds hold, it stays bounded for every box and every bounded c exactly if Mtot is Hurwitz, for every sampling.
From sample to sample

    w(t_k + s) = E_w(s) w(t_k) + Gamma_w(s) c,    E_w(s) = I + s Phi(s),    Phi(s) = phi_1((P + N) s) Mtot

whether or not the bounds enclose the state. Where E_w contracts under the law, w settles at (-Mtot)^-1 c, the fixed
point of every E_w(s): for constant bounds exactly there.
"""

from __future__ import annotations

from functools import reduce
from typing import Any, Self

import numpy as np
from flint import arb

from cdobs_cli.arrays import Array
from cdobs_cli.certificate import Witness
from cdobs_cli.certify.methods.base import Proof, Question
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import ExactMatrix, lower_text
from cdobs_cli.families.interval.held import contracts, growing_period, growth_and_slope
from cdobs_cli.families.interval.method import DIGITS, Part
from cdobs_cli.families.interval.parts import absolute, solve
from cdobs_cli.families.interval.system import System
from cdobs_cli.families.interval.theorems import Coordinates, width_flow, width_matrix
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw


@dataclass(frozen=True)
class Hurwitz(Part):
    """w* > 0 with Mtot w* < 0, shape (n, 1)."""

    w_star: ExactMatrix

    name = "hurwitz"
    rung = "boundedness"
    how = "w* > 0 with Mtot w* < 0"

    @classmethod
    def propose(cls, question: Question) -> Self | None:
        system = System.of(question)
        w_star = find_w_star(width_matrix(system.floats.Q0, system.floats.Q1))
        return None if w_star is None else cls(question.law, w_star).proved(question)

    def _prove(self, question: Question) -> Proof:
        rate = prove_hurwitz(System.of(question).Mtot, self.w_star.balls())
        return Proof.of(rate is not None, rate)


def find_w_star(Mtot: Array) -> ExactMatrix | None:
    """w* = (-Mtot)^-1 (1, .., 1)', the natural witness of a Hurwitz Metzler matrix, in short decimals."""
    try:
        w = np.linalg.solve(-Mtot, np.ones(len(Mtot)))
    except np.linalg.LinAlgError:
        return None
    if not np.all(np.isfinite(w)) or np.any(w <= 0):
        return None
    return ExactMatrix.from_floats(w.reshape(-1, 1) / w.max(), DIGITS)


def prove_hurwitz(Mtot: Matrix, w_star: Matrix) -> arb | None:
    """The decay rate min_i -(Mtot w*)_i / w*_i > 0 where w* > 0 and Mtot w* < 0 are proved; else None.

    A Metzler matrix is Hurwitz exactly if such a w* exists; then every width below a multiple of w* stays
    below it, and shrinks to the final width.

    Source: Efimov2016, Theorem 1
    Deviates: necessary and sufficient while the bounds hold, in place of LMI (15), and for every sampling.
    """
    image = -(Mtot @ w_star)
    falls = [(arb(image[i, 0]), arb(w_star[i, 0])) for i in range(Mtot.shape[0])]
    if w_star.shape[0] != len(falls) or not all(fall > 0 and weight > 0 for fall, weight in falls):
        return None
    return reduce(arb.min, [fall / weight for fall, weight in falls])


def refute_hurwitz(Mtot: Matrix) -> Witness | None:
    """A vector w >= 0, w != 0, with Mtot w >= rate w, rate > 0, proved: a width that contains a multiple of w
    grows at least like exp(rate t) between any samples. The witness holds w and the rate.
    """
    values, vectors = np.linalg.eig(Mtot.floats)
    top = int(np.argmax(values.real))
    if not values[top].real > 0:
        return None
    w = np.abs(vectors[:, top].real)
    w = np.where(w > 1e-9 * w.max(), w / w.max(), 0.0)
    exact = ExactMatrix.from_floats(w.reshape(-1, 1), DIGITS)
    image = Mtot @ exact.balls()
    # Mtot is Metzler: entries outside the support of w only grow.
    growths = [(arb(image[i, 0]), row[0].ball()) for i, row in enumerate(exact.rows) if row[0].sign() != 0]
    if not growths or not all(growth > 0 for growth, _ in growths):
        return None
    texts = tuple(row[0] for row in exact.texts())
    rate = reduce(arb.min, [growth / weight for growth, weight in growths])
    return Witness("vector", "plant", values=(texts,), data={"width": list(texts), "rate": lower_text(rate)})


def final_width(z: Coordinates, Mtot: Any, disturbance: Any, noise: Any) -> Any:
    """|S^-1| (-Mtot)^-1 (|S| (d_upper - d_lower) + |S L| (v_upper - v_lower)): where the width of x settles for
    constant bounds, whatever the sampling. Shapes (n, 1); needs Mtot Hurwitz.

    Source: Efimov2016, (12), (13)
    """
    c = absolute(z.S) @ disturbance + absolute(z.SL) @ noise
    return absolute(z.R) @ solve(-Mtot, c)


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
