"""The repaired Theorem 1, for the class (16): search for (P, alpha) at a given gain, and proof of a stored pair."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.definite import Definiteness, positive_definite
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text
from cdobs_cli.families.lpv_zoh import theorems
from cdobs_cli.families.lpv_zoh.structure import is_class_16
from cdobs_cli.families.lpv_zoh.units import Units
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    import numpy as np
    from flint import arb
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

METHOD = "repaired"
_DIGITS = 12
_ALPHAS = (0.003, 0.9)  # alpha tau_max < 1
_UNDECIDED = Definiteness("undecided", None)


def prove(plant: Plant, L: ExactMatrix, certificate: Certificate) -> Definiteness:
    """Prove P > 0 and both repaired inequalities at every vertex, from the exact plant and stored decimals."""
    from cdobs_cli.exact.matrix import Matrix

    if not is_class_16(plant):
        return _UNDECIDED
    view = PlantView.balls(plant, {"L": L})
    P = ExactMatrix(certificate.data["P"]).balls()
    tau, alpha, beta = numbers(certificate)
    if P.shape != view.A.shape or P.T.data != P.data or not 0 < beta < alpha or not alpha * tau < 1:
        return _UNDECIDED
    R = Matrix.from_rows([[int(j == 1) for j in range(plant.n)]])
    one = Matrix.identity(1)
    forms = [P, theorems.repaired_jump(P, view.C, view.gain["L"][0, 0], tau, beta)]
    for A_i in theorems.vertices_25(view):
        F_i = A_i - view.gain["L"] @ view.C
        forms.append(-theorems.repaired_flow(P, view.gain["L"], F_i, R, tau, alpha, one))
    margin: Fraction | None = None
    for form in forms:
        result = positive_definite(form)
        if not result.proved or result.margin is None:
            return _UNDECIDED
        margin = result.margin if margin is None else min(margin, result.margin)
    return Definiteness("proved", margin)


def numbers(certificate: Certificate) -> tuple[Any, Any, Any]:
    """tau_max, alpha, beta of a certificate, exact or enclosed."""
    from cdobs_cli.families.lpv_zoh.printed import scalar

    return scalar(certificate.sampling.T_max), scalar(Exact(certificate.data["alpha"])), scalar(Exact(certificate.data["beta"]))


def rate(certificate: Certificate) -> arb:
    """The rate that a proved certificate gives |e|: half of `theorems.lemma_5_rate`."""
    from flint import arb

    tau, alpha, beta = numbers(certificate)
    return arb(theorems.lemma_5_rate(arb(alpha), arb(beta), arb(alpha * tau).exp()) / 2)


def search(plant: Plant, L: Array, tau: float, alpha_tau: float) -> tuple[Array, float]:
    """P of the largest margin in both inequalities, floats, no proof."""
    import numpy as np

    from cdobs_cli.certify.lmi import symmetric
    from cdobs_cli.families.lpv_zoh.corners import largest_margin

    given = PlantView.floats(plant, {})
    units = Units.of(given, tau, slower=1.0)  # the class (16) is kept
    view, L_s = units.view(given), units.gain_in(L)
    R, one = np.eye(1, plant.n, 1), np.eye(1)
    solution, margin = largest_margin(
        {"P": symmetric(plant.n)},
        lambda x, A_i: theorems.repaired_flow(x["P"], L_s, A_i - L_s @ view.C, R, 1.0, alpha_tau, one),
        theorems.vertices_25(view),
        (lambda x: x["P"], lambda x: theorems.repaired_jump(x["P"], view.C, L_s[0, 0], 1.0, alpha_tau)),
    )
    return units.states_out(solution.values["P"]) * tau, margin


def analyse(plant: Plant, L: ExactMatrix, tau_max: Exact, sigma: Fraction = Fraction(0)) -> Certificate | None:
    """A certificate for this gain, every T_k <= tau_max and at least the rate sigma, already proved.

    Over a line search on alpha, the one of the fastest rate. None where none was found.
    """
    import numpy as np

    tau = float(tau_max)
    if not is_class_16(plant) or not np.all(np.isfinite(L.floats)):
        return None
    L_1 = L.floats[0, 0]
    best: tuple[float, dict[str, Any]] | None = None
    for alpha_tau in np.geomspace(*_ALPHAS, 12).tolist():
        P, margin = search(plant, L.floats, tau, alpha_tau)
        if not margin > 0:
            continue
        alpha = alpha_tau / tau
        beta = 2 * tau * tau * L_1 * L_1 * float(np.linalg.inv(P)[0, 0])
        beta += 1e-3 * (alpha - beta)
        speed = theorems.lemma_5_rate(alpha, beta, np.exp(alpha_tau)) / 2
        if best is None or speed > best[0]:
            data = {"P": ExactMatrix.from_floats(P, _DIGITS).texts(), "alpha": decimal_text(alpha, 9), "beta": decimal_text(beta, 12)}
            best = (speed, data)
    if best is None:
        return None
    certificate = Certificate(METHOD, plant.sampling.with_period(tau_max), best[1])
    proved = prove(plant, L, certificate).proved and rate(certificate) >= Exact(sigma).ball()
    return certificate if proved else None
