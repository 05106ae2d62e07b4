"""Would a box that knows the gain reach further than the clock certificate? Floats only: nothing here is a proof.

For C K = I and e_1 = 0 after a sample, the error maps are [-K_2, I] Phi_V(delta) N. The entries of that matrix over
bang-bang V with up to two switches give a box that is too small, if anything; the least common quadratic contraction
rate over its vertices, minimised over K_2, is then below what any proof with such a box could show. Where it exceeds 1
the method has ended.

    python tests/benchmarks/bench_gain_aware_box.py
"""

from __future__ import annotations

import itertools

import numpy as np
import rooms  # noqa: F401 - opens the folders
from scipy.linalg import expm
from scipy.optimize import minimize

from cdobs_cli.certify.lmi import Program, full, symmetric

# Slopes of the last row, a first K_2, and the period that the clock certificate proves at effort 1.
PLANTS = [
    ((1, 0, 0), (1.2, 0.7), 1.5666),
    ((1, 1, 1), (3.3, 5.5), 0.6348),
    ((1, 0, 0, 0), (1.8, 1.3, 0.6), 1.472),
]
GRID = 10


def flow_maps(c: tuple[float, ...], delta: float) -> np.ndarray:
    """Phi_V(delta) for bang-bang V with at most two switches."""
    n = len(c)
    uncertain = [k for k in range(n) if c[k]]

    def arc(signs: tuple[int, ...], share: int) -> np.ndarray:
        M = np.diag(np.ones(n - 1), 1)
        for k, sign in zip(uncertain, signs, strict=True):
            M[n - 1, k] += sign * c[k]
        return expm(M * delta * share / GRID)

    corners = list(itertools.product((-1, 1), repeat=len(uncertain)))
    arcs = {(v, i): arc(v, i) for v in corners for i in range(GRID + 1)}
    maps = [arcs[v, GRID] for v in corners]
    maps += [arcs[w, GRID - i] @ arcs[v, i] for v, w in itertools.permutations(corners, 2) for i in range(1, GRID)]
    maps += [
        arcs[v, GRID - j] @ arcs[w, j - i] @ arcs[v, i]
        for v, w in itertools.permutations(corners, 2)
        for i, j in itertools.combinations(range(1, GRID), 2)
    ]
    return np.array(maps)


def contraction(K_2: np.ndarray, Phi: np.ndarray) -> float:
    """The least rate that one quadratic function shows for all vertices of the box."""
    m = Phi.shape[1] - 1
    M = np.hstack([-K_2[:, None], np.eye(m)]) @ Phi[:, :, 1:]
    centre, radius = (M.min(0) + M.max(0)) / 2, (M.max(0) - M.min(0)) / 2
    signs = list(itertools.product((-1, 1), repeat=m))
    vertices = [centre + np.diag(e) @ radius @ np.diag(s) for e in signs for s in signs]

    def holds(rate: float) -> bool:
        program = Program({"Q": symmetric(m), "t": full(1, 1)})
        for V in vertices:
            program.require(lambda x, V=V: rate**2 * x["Q"] - V.T @ x["Q"] @ V - x["t"] * np.eye(m))
        program.require(lambda x: x["Q"] - 1e-6 * np.eye(m))
        program.equate(lambda x: np.trace(x["Q"]) - 1)
        program.maximise(lambda x: x["t"])
        return program.solve().values["t"][0, 0] > 1e-9

    low, high = 0.0, 4.0
    for _ in range(10):
        middle = (low + high) / 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def main() -> None:
    for c, K_2, clock in PLANTS:
        print(f"c = {c}: the clock certificate proves {clock}")
        start = np.array(K_2)
        for share in (0.7, 0.8, 0.9, 1.0):
            Phi = flow_maps(c, share * clock)
            found = minimize(
                contraction,
                start,
                args=(Phi,),
                method="Nelder-Mead",
                options={"maxfev": 60, "xatol": 1e-3, "fatol": 1e-3},
            )
            start = found.x
            told = "" if found.fun < 1 else "  (nothing to prove)"
            print(f"  period {share * clock:.4f}: contraction {found.fun:.3f}{told}", flush=True)


if __name__ == "__main__":
    main()
