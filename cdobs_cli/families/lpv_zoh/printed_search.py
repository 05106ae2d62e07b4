"""(P, Y) that meet every condition of the printed Theorem 1 at one gain, Y = P L."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cdobs_cli.certificate import Certificate
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.lpv_zoh import theorems
from cdobs_cli.families.lpv_zoh.printed import Printed, scalar, side_conditions
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

METHOD = "theorem_1"
_DIGITS = 9
_SIZES = (1e-3, 1e2)


def prove(plant: Plant, L: ExactMatrix, certificate: Certificate) -> bool:
    """Whether the stored (P, Y) meet the printed conditions at the certificate's period."""
    view = PlantView.balls(plant, {"L": L})
    P, Y = (ExactMatrix(certificate.data[name]) for name in ("P", "Y"))
    data = Printed.of(P, Y, L, view.C, theorems.vertices_25(view))
    return data is not None and side_conditions(data, scalar(certificate.sampling.T_max)) == "proved"


def search(plant: Plant, L: ExactMatrix, tau_max: Exact) -> Certificate | None:
    """(P, P L) that are proved to meet the printed conditions at tau_max, or None.

    With lambda_max(P) held at a trial value, delta and beta are numbers, and mu lambda_min(P) is maximised:
    [[mu, s], [s, lambda_min]] >= 0 with s as objective.
    """
    import numpy as np

    from cdobs_cli.certify.lmi import Program, full, symmetric

    view = PlantView.floats(plant, {"L": L})
    gain, tau, n = view.gain["L"], float(tau_max), plant.n
    R, one, identity = np.eye(1, n, 1), np.eye(1), np.eye(n)
    L_1 = float(gain[0, 0])
    vertices = theorems.vertices_25(view)
    best: tuple[float, Array] | None = None
    for size in np.geomspace(*_SIZES, 11):
        beta = theorems.theorem_1_beta(tau, size, L_1)
        delta = 1 + 1.001 * beta / (2 * tau)
        program = Program({"P": symmetric(n), "mu": full(1, 1), "low": full(1, 1), "s": full(1, 1)})
        for A_i in vertices:
            program.require(
                lambda x, A_i=A_i, delta=delta: (
                    -theorems.lmi_26_schur(  # type: ignore[misc]
                        x["P"], x["P"] @ gain, A_i, view.C, R, tau, delta, x["mu"], identity, one
                    )
                )
            )
        program.require(lambda x, size=size: identity * size - x["P"])  # type: ignore[misc]
        program.require(lambda x: x["P"] - identity * x["low"])
        program.require(lambda x: np.block([[x["mu"], x["s"]], [x["s"], x["low"]]]))
        program.maximise(lambda x: x["s"])
        solution = program.solve()
        s = float(solution.values["s"][0, 0])
        if np.isfinite(s) and s > 0 and (best is None or s * s / beta > best[0]):
            best = (s * s / beta, solution.values["P"])
    if best is None or best[0] <= 1:
        return None
    P = ExactMatrix.from_floats(best[1], _DIGITS)
    Y = ExactMatrix.from_floats(P.floats @ gain, _DIGITS)
    certificate = Certificate(METHOD, plant.sampling.with_period(tau_max), {"P": P.texts(), "Y": Y.texts()})
    return certificate if prove(plant, L, certificate) else None
