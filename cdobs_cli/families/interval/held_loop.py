"""Feedback from the bounds: the separation principle, and its proof for the held loop.

    u = K_lower z_lower + K_upper z_upper at samples = (K_lower + K_upper) z - K_lower e_lower + K_upper e_upper

The error e does not depend on u, so the bounds hold and stay bounded with feedback exactly when they do
without it, and the state stays bounded for all bounded data exactly if the held loop does:

    xdot = A x + B K x(t_k),    K = (K_lower + K_upper) S,    x(t_k + s) = F(s) x(t_k),  F(s) = I + s Phi(s),
    Phi(s) = phi_1(A s) (A + B K),    phi_1(X) = integral_0^1 exp(X r) dr
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from flint import arb

from cdobs_cli.certificate import Witness
from cdobs_cli.certify.definite import has_positive_pivots
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix, block, symmetric
from cdobs_cli.exact.numbers import ExactMatrix, arb_fraction
from cdobs_cli.families.interval.boundedness import DIGITS, symmetrised
from cdobs_cli.families.interval.parts import zeros_like
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion, PlantView
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

_PIECES = 512


def growth(A: Matrix, closed: Matrix, s: Any) -> Matrix:
    """Phi(s) = phi_1(A s) closed, with F(s) = I + s Phi(s); s may be a ball that holds an interval.

    phi_1(A s) is the upper right block of exp([A s, I; 0, 0]).
    """
    n = A.shape[0]
    identity, zero = Matrix.identity(n), Matrix.zeros(n, n)
    both = block([[A.balls() * s, identity.balls()], [zero.balls(), zero.balls()]]).exp()
    phi_1: Matrix = both[0:n, n : 2 * n]
    return phi_1 @ closed


def decrease(P: Any, Phi: Any, s: Any) -> Any:
    """(P - F' P F)/s = -(P Phi + Phi' P + s Phi' P Phi), which has to be positive definite."""
    return -(symmetric(P @ Phi) + (Phi.T @ P @ Phi) * s)


def law_ends(law: SamplingLaw) -> tuple[Fraction, Fraction]:
    """Rational ends of an interval that holds every period of the law."""
    low, high = arb_fraction(law.T_min.ball().lower()), arb_fraction(law.T_max.ball().upper())
    return max(Fraction(0), low), high


def holds_on(property_at: Callable[[arb], bool], low: Fraction, high: Fraction, pieces: int = _PIECES) -> bool:
    """Whether a property proved on balls of s covers [low, high]: halves a piece until it is proved."""
    pending = [(low, high)]
    for _ in range(2 * pieces):
        if not pending:
            return True
        a, b = pending.pop()
        ball = fraction_ball((a + b) / 2) + arb(0, fraction_ball((b - a) / 2).upper())
        if property_at(ball):
            continue
        if b - a <= (high - low) / 2**20 or a == b:
            return False
        middle = (a + b) / 2
        pending += [(middle, b), (a, middle)]
    return False


def prove_held_loop(A: Matrix, closed: Matrix, P: Matrix, law: SamplingLaw, effort: int = 1) -> bool:
    """Whether x' P x decreases from sample to sample, in proportion to the time between, for every period of
    the law: P > 0 and P - F(s)' P F(s) > 0 for every s of the law (in the limit of its rate at s = 0).

    Args:
        closed: A + B K, shape (n, n).
    Source: Efimov2016, Section V
    Deviates: separation in place of Theorem 2's small gain: the errors do not depend on u, so the plant and its
        held feedback are all that is left to prove.
    """
    P = symmetrised(P)
    if P.shape != A.shape or not has_positive_pivots(P):
        return False
    low, high = law_ends(law)
    return holds_on(lambda s: has_positive_pivots(decrease(P, growth(A, closed, s), s)), low, high, _PIECES * 2**effort)


def find_held_loop(A: Array, closed: Array, law: SamplingLaw) -> ExactMatrix | None:
    """P for `prove_held_loop`, from the solver: the decrease at some periods of the law, largest margin."""
    import numpy as np

    from cdobs_cli.certify.falsify import exponentials
    from cdobs_cli.certify.lmi import Program, full
    from cdobs_cli.certify.lmi import symmetric as symmetric_unknown

    n = len(A)
    ends = float(law.T_min), float(law.T_max)
    periods = [ends[1]] if ends[0] == ends[1] else [ends[0] + (ends[1] - ends[0]) * (1 - np.cos(np.pi * k / 8)) / 2 for k in range(9)]
    maps = [np.block([[A * s, np.eye(n)], [np.zeros((n, 2 * n))]]) for s in periods]
    if not all(np.all(np.isfinite(m)) for m in maps):
        return None
    growths = [E[:n, n:] @ closed for E in exponentials(np.array(maps))]
    if not np.all(np.isfinite(growths)):
        return None
    program = Program({"P": symmetric_unknown(n), "t": full(1, 1)})
    identity = np.eye(n)
    for s, Phi in zip(periods, growths, strict=True):
        scale = 1 / max(float(np.linalg.norm(Phi)), 1e-12)
        program.require(lambda x, s=s, Phi=Phi, scale=scale: decrease(x["P"], Phi, s) * scale - identity * x["t"][0, 0])  # type: ignore[misc]
    program.require(lambda x: x["P"] - identity * x["t"][0, 0])
    program.equate(lambda x: np.trace(x["P"]).reshape(1, 1) - n)
    program.maximise(lambda x: x["t"])
    solution = program.solve()
    if not solution.values["t"][0, 0] > 0:
        return None
    return ExactMatrix.from_floats(solution.values["P"], DIGITS)


def held_maps(view: PlantView[Any]) -> ErrorMaps[Any]:
    """The held loop as a hybrid system of (x, K x(t_k)): flow [A B; 0 0], jump [I 0; K 0].

    Source: Efimov2016, (16)
    """
    A, S = view.A, view.gain["S"]
    B = view.gain["B"]
    K = (view.gain["K_lower"] + view.gain["K_upper"]) @ S
    n, m = A.shape[0], B.shape[1]
    unit: Any = [view.unit(i) for i in range(n)]
    identity: Any = sum((u @ u.T for u in unit[1:]), unit[0] @ unit[0].T)
    drop = (B.T @ identity) * 0
    return ErrorMaps(
        base=block([[A, B], [drop, drop @ B]]), parts=(), lower=(), upper=(),
        jump=block([[identity, B * 0], [K, drop @ B]]) if m else identity,
    )  # fmt: skip


def closed_maps(view: PlantView[Any], errors: ErrorMaps[Any]) -> ErrorMaps[Any]:
    """Plant, feedback and errors of the bounds as one system of (x, u, e, e(t_k)): the held loop driven by

        u+ = (K_lower + K_upper) S x - K_lower (z - z_lower) + K_upper (z_upper - z)

    Block triangular, so its multipliers are those of the held loop and of the errors.

    Source: Efimov2016, (16), (17)
    """
    held = held_maps(view)
    size, errors_size = held.base.shape[0], errors.base.shape[0]
    n, m = view.A.shape[0], size - view.A.shape[0]
    above, below = zeros_like(view.A, size, errors_size), zeros_like(view.A, errors_size, size)
    fed = block([[view.gain["K_lower"] * -1, view.gain["K_upper"], zeros_like(view.A, m, errors_size - 2 * n)]])
    drive = block([[zeros_like(view.A, n, errors_size)], [fed]])
    return ErrorMaps(
        base=block([[held.base, above], [below, errors.base]]), parts=(), lower=(), upper=(),
        jump=block([[held.jump, drive], [below, errors.jump]]),
    )  # fmt: skip


def held_inclusion(plant: Plant, gain: Mapping[str, ExactMatrix], law: SamplingLaw) -> HybridInclusion:
    """The held loop under a sampling law; the plant has B."""
    assert plant.B is not None
    return HybridInclusion(held_maps, plant, {**gain, "B": plant.B}, law, ())


def refute_held_loop(plant: Plant, gain: Mapping[str, ExactMatrix], law: SamplingLaw, effort: int) -> Witness | None:
    """A constant period of the law at which the held loop has a multiplier of modulus at least 1, proved."""
    from cdobs_cli.certify.falsify import refute

    witness = refute(held_inclusion(plant, gain, law), effort)
    if witness is None:
        return None
    from cdobs_cli.certify.ball import eigenvalues

    T = fraction_ball(Fraction(witness.times[0])) if _is_fraction(witness.times[0]) else None
    data = dict(witness.data)
    if T is not None:
        A, closed = closed_loop(plant, gain)
        roots = eigenvalues(Matrix.identity(plant.n) + growth(A, closed, T) * T)
        largest = max(roots, key=lambda root: float(abs(root).mid())) if roots else None
        if largest is not None:
            data["eigenvalue"] = [f"{float(largest.real.mid()):.10g}", f"{float(largest.imag.mid()):.10g}"]
    return replace(witness, data=data)


def closed_loop(plant: Plant, gain: Mapping[str, ExactMatrix]) -> tuple[Matrix, Matrix]:
    """A and A + B (K_lower + K_upper) S, in balls."""
    assert plant.B is not None
    A = plant.A.balls()
    return A, A + plant.B.balls() @ (gain["K_lower"].balls() + gain["K_upper"].balls()) @ gain["S"].balls()


def _is_fraction(text: str) -> bool:
    try:
        Fraction(text)
    except (ValueError, ZeroDivisionError):
        return False
    return True


def descriptor_design(A: Array, B: Array, Tbar: float, epsilon: float) -> Array | None:
    """K = Y Q^-1 of the held loop xdot = A x + B K x(t_k), T_k <= Tbar, by a convex LMI for fixed epsilon:
    Theorem 2's conditions with P_3 = epsilon P_2, Q = P_2^-1, and every unknown transformed by Q.

        Omega_11 = A Q + Q' A' - Y_1 - Y_1',  Omega_12 = P - Q + epsilon Q' A' - Y_2,  Omega_13 = Y_1' + B Y - R,
        Omega_22 = -epsilon (Q + Q'),  Omega_23 = Y_2' + epsilon B Y,  Omega_33 = R + R'

    Source: Efimov2016, Theorem 2
    """
    import numpy as np

    from cdobs_cli.certify.lmi import Program, full
    from cdobs_cli.certify.lmi import symmetric as symmetric_unknown

    n, m = B.shape
    square = {name: full(n, n) for name in ("Q", "X", "X_1", "Y_1", "Y_2", "R")}
    program = Program({"P": symmetric_unknown(n), "U": symmetric_unknown(n), **square, "Y": full(m, n), "t": full(1, 1)})

    def functional(x: Mapping[str, Array]) -> Array:
        half, cross = symmetric(x["X"]) / 2, x["X_1"] - x["X"]
        M = np.block([[x["P"] / Tbar + half, cross], [cross.T, half - symmetric(x["X_1"])]])
        margin: Array = M - np.eye(2 * n) * x["t"][0, 0]
        return margin

    def derivative(x: Mapping[str, Array], corner: int) -> Array:
        Q, X, X_1, Y_1, Y_2, R, BY = x["Q"], x["X"], x["X_1"], x["Y_1"], x["Y_2"], x["R"], B @ x["Y"]
        mean = symmetric(X) / 2
        A11, A12, A13 = symmetric(A @ Q - Y_1) - mean, x["P"] - Q + epsilon * Q.T @ A.T - Y_2, Y_1.T + BY - R + X - X_1
        A22, A23, A33 = -epsilon * symmetric(Q), Y_2.T + epsilon * BY, symmetric(R) - mean + symmetric(X_1)
        if corner == 0:
            A12, A22, A23 = A12 + Tbar * mean, A22 + Tbar * x["U"], A23 - Tbar * (X - X_1)
            M = np.block([[A11, A12, A13], [A12.T, A22, A23], [A13.T, A23.T, A33]])
        else:
            m1, m2, m3 = Tbar * Y_1.T, Tbar * Y_2.T, Tbar * R.T
            M = np.block([[A11, A12, A13, m1], [A12.T, A22, A23, m2], [A13.T, A23.T, A33, m3], [m1.T, m2.T, m3.T, -Tbar * x["U"]]])
        margin: Array = -M - np.eye(len(M)) * x["t"][0, 0]
        return margin

    program.require(functional)
    program.require(lambda x: derivative(x, 0))
    program.require(lambda x: derivative(x, 1))
    program.require(lambda x: x["P"] - np.eye(n) * x["t"][0, 0])
    program.require(lambda x: np.eye(n) * n - symmetric(x["Q"]) / 2)
    program.equate(lambda x: np.trace(x["P"]).reshape(1, 1) - n)
    program.maximise(lambda x: x["t"])
    values = program.solve().values
    if not values["t"][0, 0] > 0:
        return None
    try:
        K: Array = values["Y"] @ np.linalg.inv(values["Q"])
    except np.linalg.LinAlgError:
        return None
    return K if np.all(np.isfinite(K)) else None
