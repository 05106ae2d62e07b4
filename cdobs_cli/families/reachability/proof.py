"""The certificate of the set, proved in balls for the printed gain: no solver, no float decides anything."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.definite import has_positive_pivots, positive_definite
from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.reachability.interval_matrix import IntervalMatrix
from cdobs_cli.families.reachability.kernel import kernel
from cdobs_cli.families.reachability.sets import box_holds, inclusion_12, matrix_set, reachable_box
from cdobs_cli.families.reachability.theorems import error_jump, growth, recovered_P, schur_13, schur_reduced
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.reachability import Reachability

METHOD = "set"
# The paper's constants kappa and eta need the full (13), whose 2^(2n-1) members are many beyond this.
MAX_STATES_OF_CONSTANTS = 6
MAX_ENTRIES_OF_ETA = 10


@dataclass(frozen=True)
class SetProof:
    """What was proved of one certificate: each part by itself, `holds` all together.

    rho_squared: V shrinks at least by this factor over one period (None where it is not proved).
    members: how many members of the set were checked.
    """

    delta: Exact
    in_time: bool
    inclusion: bool
    positive: bool
    contraction: bool
    form: str
    members: int
    rho_squared: Fraction | None

    @property
    def holds(self) -> bool:
        return self.in_time and self.inclusion and self.positive and self.contraction


def prove(family: Reachability, plant: Plant, K: ExactMatrix, certificate: Certificate) -> SetProof:
    """Prove that the printed K contracts V over one period delta for every slope history.

    1. delta <= delta_star, so that the box of the plant's structure holds every Phi_V(delta);
    2. the box lies in the set M;
    3. C K = I exactly: Q > 0 and rho^2 Q - F'Q F > 0 with F = R (I - K C) M N at every member that matters
       (form `reduced`); otherwise P > 0 and rho^2 P - N_M'P N_M > 0 (form `full`);
    4. rho < 1.

    With n = rank C and C K = I each jump ends at e = 0, whatever delta.

    Source: Dinh2014, Theorem II.2
    """
    delta = certificate.sampling.T_max
    nothing = SetProof(delta, False, False, False, False, str(certificate.data.get("form")), 0, None)
    if not certificate.sampling.is_periodic or delta.sign() != 1:
        return nothing
    if plant.p >= plant.n and certificate.data.get("Q") == [] and kernel(plant.C).dimension == 0 and kernel(plant.C).is_kept(K):
        return SetProof(delta, True, True, True, True, "reduced", 0, Fraction(0))
    box, boxes = reachable_box(plant, delta.ball()), matrix_set(family, plant, delta)
    if box is None or boxes is None:
        return nothing
    in_time = box_holds(plant, delta.ball())
    inclusion = inclusion_12(box, boxes) if family.set != "clarke" else True
    try:
        rho_squared = _rational(certificate.data["rho_squared"])
        inequality = _reduced(plant, K, certificate) if certificate.data["form"] == "reduced" else _full(plant, K, certificate)
    except (KeyError, TypeError, ValueError, ExpressionError, ZeroDivisionError):
        return nothing
    if inequality is None:
        return SetProof(delta, in_time, inclusion, False, False, nothing.form, 0, None)
    V, contract, active = inequality
    positive = has_positive_pivots(V)
    count, contraction = 0, 0 <= rho_squared < 1
    if contraction and positive:
        for M in set_members(boxes, active):
            count += 1
            if not has_positive_pivots(contract(M, rho_squared)):
                contraction = False
                break
    proved = positive and contraction
    return SetProof(delta, in_time, inclusion, positive, contraction, nothing.form, count, rho_squared if proved else None)


def set_members(boxes: tuple[IntervalMatrix, ...], active: list[int]) -> Iterator[Matrix]:
    """Every member that matters, of every box of the set."""
    for box in boxes:
        for signs in box.signs(active):
            yield box.member(signs)


def _reduced(plant: Plant, K: ExactMatrix, certificate: Certificate) -> Any:
    space = kernel(plant.C)
    if not space.is_kept(K):
        return None
    Q = _symmetric(certificate.data["Q"], space.dimension)
    T = space.R @ error_jump(K.balls(), space.C, Matrix.identity(plant.n))
    active = [j for j in range(plant.n) if any(not _is_zero(space.N[j, b]) for b in range(space.dimension))]
    return Q, lambda M, rho_squared: schur_reduced(Q, T @ M @ space.N, rho_squared), active


def _full(plant: Plant, K: ExactMatrix, certificate: Certificate) -> Any:
    P = _symmetric(certificate.data["P"], plant.n)
    jump = error_jump(K.balls(), plant.C.balls(), Matrix.identity(plant.n))
    return P, lambda M, rho_squared: schur_reduced(P, jump @ M, rho_squared), list(range(plant.n))


def lyapunov_matrix(plant: Plant, K: ExactMatrix, certificate: Certificate) -> Matrix:
    """P of (13): stored in form `full`, recovered from Q and s in form `reduced`."""
    if certificate.data["form"] == "full":
        return _symmetric(certificate.data["P"], plant.n)
    space = kernel(plant.C)
    R_tilde = space.R @ error_jump(K.balls(), space.C, Matrix.identity(plant.n))
    Q = _symmetric(certificate.data["Q"], space.dimension)
    P: Matrix = recovered_P(Q, R_tilde, space.C_r, _rational(certificate.data["s"]))
    return P


@dataclass(frozen=True)
class Constants:
    """The paper's kappa (proved lower end) and eta (proved upper end), in |e|' P |e|."""

    kappa: Fraction
    eta: Fraction


def constants(family: Reachability, plant: Plant, K: ExactMatrix, certificate: Certificate) -> Constants | None:
    """kappa = min lambda_min(P - N_M'P N_M) / lambda_max(P) and eta = max(lambda_max(P R + R'P), 0) / lambda_min(P).

    Floats suggest each eigenvalue, pivots decide; None where (13) itself is not proved for this P.

    Source: Dinh2014, proof of Theorem II.2
    """
    import numpy as np

    if (
        plant.n > MAX_STATES_OF_CONSTANTS
        or len(plant.slopes.uncertain) > MAX_ENTRIES_OF_ETA
        or ("s" not in certificate.data and certificate.data["form"] == "reduced")
    ):
        return None
    boxes = matrix_set(family, plant, certificate.sampling.T_max)
    if boxes is None:
        return None
    P = lyapunov_matrix(plant, K, certificate)
    jump = error_jump(K.balls(), plant.C.balls(), Matrix.identity(plant.n))
    one = Matrix.identity(plant.n)
    gaps = [schur_13(P, jump @ M) for M in set_members(boxes, list(range(plant.n)))]
    rates = [growth(P, R) for R in slope_corners(plant)]
    eigenvalues = np.linalg.eigvalsh(P.floats)
    least = Fraction(0.999 * float(min(np.linalg.eigvalsh(gap.floats)[0] for gap in gaps)))
    largest, smallest = Fraction(1.000001 * float(eigenvalues[-1])), Fraction(0.999999 * float(eigenvalues[0]))
    top = Fraction(max(0.0, 1.001 * max(float(np.linalg.eigvalsh(rate.floats)[-1]) for rate in rates)) + 1e-9 * float(largest))
    proved = (
        least > 0
        and smallest > 0
        and positive_definite(P - one * smallest).proved
        and positive_definite(one * largest - P).proved
        and all(has_positive_pivots(gap - one * least) for gap in gaps)
        and all(has_positive_pivots(one * top - rate) for rate in rates)
    )
    return Constants(least / largest, top / smallest) if proved else None


def slope_corners(plant: Plant) -> Iterator[Matrix]:
    """A + V at the corners of the slope box: the set R of the paper."""
    from itertools import product

    view = PlantView.balls(plant, {})
    for v in product(*zip(view.lower, view.upper, strict=True)):
        R = view.A
        for value, (i, j) in zip(v, view.entries, strict=True):
            R = R + (view.unit(i) @ view.unit(j).T) * value
        yield R


def _symmetric(rows: list[list[str]], size: int) -> Matrix:
    matrix = ExactMatrix(rows)
    if matrix.shape != (size, size) or any(matrix[i, j] != matrix[j, i] for i in range(size) for j in range(i)):
        raise ValueError("a symmetric matrix is expected")
    return matrix.balls()


def _rational(text: str) -> Fraction:
    value = Exact(text).rational
    if value is None:
        raise ValueError("a decimal number is expected")
    return value


def _is_zero(value: Any) -> bool:
    from flint import arb

    return bool(value.is_zero()) if isinstance(value, arb) else bool(value == 0)
