"""Whether the width of the bounds stays bounded, and what it settles at: exactly, and by the paper's LMI (15).

The width w = z_upper - z_lower obeys w' = (P + N) w + |Q1| w(t_k) + c with c the width of delta. While the
bounds hold, it stays bounded for every box and every bounded c exactly if Mtot is Hurwitz, for every sampling.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from flint import arb

from cdobs_cli.certificate import Witness
from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import ExactMatrix, lower_text
from cdobs_cli.families.interval.parts import absolute
from cdobs_cli.families.interval.theorems import Coordinates, lmi_15, paper_flow

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

DIGITS = 12


def find_w_star(Mtot: Array) -> ExactMatrix | None:
    """w* = (-Mtot)^-1 (1, .., 1)', the natural witness of a Hurwitz Metzler matrix, in short decimals."""
    import numpy as np

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
    image = Mtot @ w_star
    rate: arb | None = None
    for i in range(Mtot.shape[0]):
        weight, slope = arb(w_star[i, 0]), arb(image[i, 0])
        if not (weight > 0 and slope < 0):
            return None
        share = -slope / weight
        rate = share if rate is None else arb.min(rate, share)
    return rate


def refute_hurwitz(Mtot: Matrix) -> Witness | None:
    """A vector w >= 0, w != 0, with Mtot w >= rate w, rate > 0, proved: a width that contains a multiple of w
    grows at least like exp(rate t) between any samples. The witness holds w and the rate.
    """
    import numpy as np

    values, vectors = np.linalg.eig(Mtot.floats)
    top = int(np.argmax(values.real))
    if not values[top].real > 0:
        return None
    w = np.abs(vectors[:, top].real)
    w = np.where(w > 1e-9 * w.max(), w / w.max(), 0.0)
    exact = ExactMatrix.from_floats(w.reshape(-1, 1), DIGITS)
    vector = exact.balls()
    image = Mtot @ vector
    rate: arb | None = None
    for i in range(Mtot.shape[0]):
        weight, slope = arb(vector[i, 0]), arb(image[i, 0])
        if weight.is_zero():
            continue  # Metzler: entries outside the support only grow
        if not slope > 0:
            return None
        share = slope / weight
        rate = share if rate is None else arb.min(rate, share)
    if rate is None:
        return None
    texts = tuple(row[0] for row in exact.texts())
    return Witness("vector", "plant", values=(texts,), data={"width": list(texts), "rate": lower_text(rate)})


def final_width(z: Coordinates[Any], Mtot: Any, disturbance: Any, noise: Any) -> Any:
    """|S^-1| (-Mtot)^-1 (|S| (d_upper - d_lower) + |S L| (v_upper - v_lower)): where the width of x settles for
    constant bounds, whatever the sampling. Shapes (n, 1); needs Mtot Hurwitz.

    Source: Efimov2016, (12), (13)
    """
    c = absolute(z.S) @ disturbance + absolute(z.SL) @ noise
    return absolute(z.R) @ solve(-Mtot, c)


def solve(A: Any, b: Any) -> Any:
    """A^-1 b in the arithmetic of A."""
    if isinstance(A, Matrix):
        return A.solve(b)
    import numpy as np

    return np.linalg.solve(A, b)


@dataclass(frozen=True)
class Lmi15:
    """A solution of (15) at Tbar, for the sum (Phi_0 = Q0) and the difference (Phi_0 = P + N) of the bounds."""

    P: tuple[ExactMatrix, ExactMatrix]
    W: tuple[ExactMatrix, ExactMatrix]

    def document(self) -> dict[str, Any]:
        return {name: [matrix.texts() for matrix in pair] for name, pair in (("P", self.P), ("W", self.W))}

    @staticmethod
    def from_document(document: dict[str, Any]) -> Lmi15:
        """Raises: KeyError, ValueError on what `document` did not write."""
        P, W = ([ExactMatrix(rows) for rows in document[name]] for name in ("P", "W"))
        return Lmi15((P[0], P[1]), (W[0], W[1]))


def prove_lmi_15(z: Coordinates[Matrix], certificate: Lmi15, Tbar: arb) -> bool:
    """Whether (15), P > 0 and W > 0 are proved at Tbar for the stored solution.

    Source: Efimov2016, Theorem 1, (15)
    """
    tau = Tbar * 2 / arb.pi()
    for Phi_0, P, W in zip(paper_flow(z.Q0, z.Q1), certificate.P, certificate.W, strict=True):
        p, w = symmetrised(P.balls()), symmetrised(W.balls())
        if p.shape != Phi_0.shape or w.shape != Phi_0.shape:
            return False
        if not (has_positive_pivots(p) and has_positive_pivots(w) and has_positive_pivots(-lmi_15(Phi_0, z.Q1, p, w, tau))):
            return False
    return True


def symmetrised(M: Matrix) -> Matrix:
    """(M + M')/2: stored matrices are symmetric up to what someone typed."""
    return (M + M.T) * Fraction(1, 2)


def find_lmi_15(z: Coordinates[Array], exact: Coordinates[Matrix], Tbar: Fraction) -> Lmi15 | None:
    """A solution of (15) at Tbar, found by the solver and proved from its printed digits."""
    import numpy as np

    from cdobs_cli.certify.lmi import Program, full, symmetric

    pairs = []
    n = len(z.Q0)
    identity = np.eye(n)
    tau = 2 * float(Tbar) / np.pi
    for Phi_0 in paper_flow(z.Q0, z.Q1):
        program = Program({"P": symmetric(n), "W": symmetric(n), "t": full(1, 1)})

        def slack(x: Any, Phi_0: Array = Phi_0) -> Array:
            t = x["t"][0, 0]
            W = x["W"]
            weight = np.kron(np.diag([1.0, 0, 0]), identity) * t
            result: Array = -lmi_15(Phi_0, z.Q1, x["P"], W, tau) - weight
            return result

        program.require(slack)
        program.require(lambda x: x["P"] - identity * x["t"][0, 0])
        program.require(lambda x: x["W"])
        program.equate(lambda x: np.trace(x["P"]).reshape(1, 1) - 1)
        program.maximise(lambda x: x["t"])
        solution = program.solve()
        if not solution.values["t"][0, 0] > 0:
            return None
        pairs.append((ExactMatrix.from_floats(solution.values["P"], DIGITS), ExactMatrix.from_floats(solution.values["W"], DIGITS)))
    found = Lmi15((pairs[0][0], pairs[1][0]), (pairs[0][1], pairs[1][1]))
    return found if prove_lmi_15(exact, found, fraction_ball(Tbar)) else None


def lmi_15_limit(z: Coordinates[Matrix]) -> arb | None:
    """A period at and above which (15) has no solution: pi / (2 rho), rho = the largest -Q1_kk of a triangular
    Q1, from its lower right block W > tau^2 Phi_1' W Phi_1; None where no such bound is enclosed.

    Source: Efimov2016, Theorem 1, (15)
    """
    from cdobs_cli.certify.ball import spectral_radius_lower

    rho = spectral_radius_lower(z.Q1)
    return (arb.pi() / (2 * rho)).upper() if rho > 0 else None
