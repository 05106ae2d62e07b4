"""The Wirtinger condition: search for (P, U), proof of a stored pair, and the gain with its line search."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.definite import Definiteness, positive_definite
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh import theorems
from cdobs_cli.families.lpv_zoh.units import Units
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

METHOD = "wirtinger"
_DIGITS = 12
_EPSILONS = (0.05, 20.0)
_COARSE = 5000  # (n + p)^3 times corners beyond which the line search is a glance
_UNDECIDED = Definiteness("undecided", None)


def q_of(tau_max: Exact) -> Any:
    """q = (2 tau_max / pi)^2, enclosed."""
    from flint import arb

    root = 2 * tau_max.ball() / arb.pi()
    return root * root


def prove(plant: Plant, L: ExactMatrix, certificate: Certificate) -> Definiteness:
    """Prove P > 0, U > 0 and `theorems.wirtinger` < 0 at every vertex, from the exact plant and stored decimals.

    The rate sigma and the period are those of the certificate; the margin is the least of all.
    """
    from cdobs_cli.exact.matrix import Matrix

    view = PlantView.balls(plant, {"L": L})
    P, U = (ExactMatrix(certificate.data[name]).balls() for name in ("P", "U"))
    sigma = Fraction(certificate.data["sigma"])
    if P.shape != view.A.shape or U.shape != (plant.p, plant.p) or P.T.data != P.data or U.T.data != U.data or sigma < 0:
        return _UNDECIDED
    q, identity = q_of(certificate.sampling.T_max), Matrix.identity(plant.p)
    margin: Fraction | None = None
    forms = [P, U]
    for A_i in theorems.vertices_25(view):
        F_i = A_i - view.gain["L"] @ view.C
        forms.append(-theorems.wirtinger(P, U, F_i, view.gain["L"], view.C, q, sigma, identity))
    for form in forms:
        result = positive_definite(form)
        if not result.proved or result.margin is None:
            return _UNDECIDED
        margin = result.margin if margin is None else min(margin, result.margin)
    return Definiteness("proved", margin)


def analyse(plant: Plant, L: ExactMatrix, tau_max: Exact, sigma: Fraction = Fraction(0)) -> Certificate | None:
    """A certificate for this gain, every T_k <= tau_max and the rate sigma, already proved; None where none was found."""
    import numpy as np

    from cdobs_cli.certify.lmi import symmetric
    from cdobs_cli.families.lpv_zoh.corners import largest_margin

    tau = float(tau_max)
    given = PlantView.floats(plant, {"L": L})
    units = Units.of(given, tau)
    view = units.view(given)
    L_s, q, identity = view.gain["L"], (2 / np.pi) ** 2, np.eye(plant.p)
    vertices = theorems.vertices_25(view)
    if not np.all(np.isfinite(vertices)) or not np.all(np.isfinite(L_s)):
        return None
    solution, margin = largest_margin(
        {"P": symmetric(plant.n), "U": symmetric(plant.p)},
        lambda x, A_i: theorems.wirtinger(x["P"], x["U"], A_i - L_s @ view.C, L_s, view.C, q, float(sigma) * tau, identity),
        vertices,
        (lambda x: x["P"], lambda x: x["U"]),
        lambda x: np.trace(x["P"]) - 1,
    )
    if not margin > 0:
        return None
    P, U = units.states_out(solution.values["P"]), units.outputs_out(solution.values["U"])
    scale = np.trace(P)
    data = {
        "P": ExactMatrix.from_floats(P / scale, _DIGITS).texts(),
        "U": ExactMatrix.from_floats(U / scale, _DIGITS).texts(),
        "sigma": str(Exact(sigma)),
    }
    certificate = Certificate(METHOD, plant.sampling.with_period(tau_max), data)
    return certificate if prove(plant, L, certificate).proved else None


@dataclass(frozen=True)
class Proposal:
    """A gain from `theorems.wirtinger_synthesis` in the user's units, and how far the inequality is from its edge."""

    L: Array
    margin: float
    epsilon: float


def propose(plant: Plant, tau: float, sigma: float, epsilon: float) -> Proposal:
    """The gain of the largest margin for every T_k <= tau, the rate sigma and one epsilon (in units of tau).

    A margin that is not positive means that none was found.
    """
    import numpy as np

    from cdobs_cli.certify.lmi import full, symmetric
    from cdobs_cli.families.lpv_zoh.corners import largest_margin

    given = PlantView.floats(plant, {})
    units = Units.of(given, tau)
    view = units.view(given)
    n, p, q = plant.n, plant.p, (2 / np.pi) ** 2
    none = Proposal(np.zeros((n, p)), -np.inf, epsilon)
    vertices = theorems.vertices_25(view)
    if not np.all(np.isfinite(vertices)):
        return none
    solution, margin = largest_margin(
        {"P": symmetric(n), "S": full(n, n), "Y": full(n, p), "U": symmetric(p)},
        lambda x, A_i: theorems.wirtinger_synthesis(x["P"], x["S"], x["Y"], x["U"], A_i, view.C, q, epsilon, sigma * tau),
        vertices,
        (lambda x: x["P"], lambda x: x["U"]),
        lambda x: np.trace(x["P"]) - 1,
    )
    try:
        L = np.array(np.linalg.solve(solution.values["S"], solution.values["Y"]), dtype=np.float64)
    except np.linalg.LinAlgError:
        return none
    # Where the plant falls into parts, what couples them is the solver's noise.
    L[np.abs(L) < 1e-9 * np.abs(L).max()] = 0.0
    return Proposal(units.gain_out(L), margin, epsilon) if np.all(np.isfinite(L)) else none


def design(plant: Plant, tau: float, sigma: float = 0.0) -> Proposal:
    """`propose` over a line search on epsilon: the gain of the largest margin met."""
    import numpy as np

    size = (plant.n + plant.p) ** 3 * 2 ** len(plant.slopes.uncertain)
    if size > _COARSE:
        return max((propose(plant, tau, sigma, epsilon) for epsilon in (1.0, 3.0, 0.3)), key=lambda proposal: proposal.margin)
    tried = [propose(plant, tau, sigma, float(epsilon)) for epsilon in np.geomspace(*_EPSILONS, 9)]
    best = max(range(len(tried)), key=lambda k: tried[k].margin)
    low, high = tried[max(best - 1, 0)].epsilon, tried[min(best + 1, len(tried) - 1)].epsilon
    found = tried[best]
    for _ in range(3):
        middle = (low * high) ** 0.5
        left, right = (propose(plant, tau, sigma, epsilon) for epsilon in ((low * middle) ** 0.5, (middle * high) ** 0.5))
        found = max(found, left, right, key=lambda proposal: proposal.margin)
        if left.margin > right.margin:
            high = middle
        else:
            low = middle
    return found


def redesign(plant: Plant, tau: float, sigma: float, epsilon: float) -> Proposal:
    """`propose` at an epsilon that did well nearby; the whole line search where that fails."""
    found = propose(plant, tau, sigma, epsilon)
    return found if found.margin > 0 else design(plant, tau, sigma)


def fastest(plant: Plant, tau: float) -> tuple[float, Proposal]:
    """The largest rate met at one period, and its proposal; the margin is not positive where there is none.

    Doubles the rate from 1 / tau, then bisects, at the epsilon that did best before.
    """
    best = design(plant, tau)
    low, high = 0.0, 1.0 / tau
    if not best.margin > 0:
        return low, best
    while (above := redesign(plant, tau, high, best.epsilon)).margin > 0 and high < 1e3 / tau:
        low, high, best = high, 2 * high, above
    for _ in range(8):
        middle = (low + high) / 2
        at_middle = propose(plant, tau, middle, best.epsilon)
        if at_middle.margin > 0:
            low, best = middle, at_middle
        else:
            high = middle
    return low, best
