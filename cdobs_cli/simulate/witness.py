"""A counterexample of the slope class run again: the error under the witness's own V(t) and sampling periods.

    edot = (base + sum_k v_k(t) left_k right_k) e,    e+ = J e at the samples,    e(0) the growing eigenvector of

    M = J Phi_m .. J Phi_1

Within an arc V is constant, so every point is a matrix exponential away from the arc's start.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cdobs_cli.arrays import Array
from cdobs_cli.certificate import Witness
from cdobs_cli.errors import UsageError
from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import HybridInclusion
from cdobs_cli.records import dataclass

_POINTS = 24  # of an arc
_GROWTH = 100.0  # how far the error should have grown at the end
_FEWEST, _MOST = 6, 60  # repetitions of the word


@dataclass(frozen=True)
class Replay:
    """The run of a witness.

    t (N,) holds both sides of each jump and each switch (equal t twice); e (N, size of the error); V (N, number
    of uncertain slopes), in the order of `entries`; t_k (K,) the samples; multiplier the growth per word of
    sampling periods as measured on this run, stated the proved one.
    """

    t: Array
    e: Array
    V: Array
    t_k: Array
    entries: tuple[tuple[int, int], ...]
    multiplier: float
    stated: str | None

    def arrays(self) -> dict[str, NDArray[Any]]:
        """For an .npz beside the simulation's."""
        entries = np.array(self.entries, dtype=np.int64).reshape(len(self.entries), 2)
        return {"t": self.t, "e": self.e, "V": self.V, "t_k": self.t_k, "entries": entries}

    def document(self) -> dict[str, Any]:
        """The figures of the run."""
        sizes = np.sqrt((self.e * self.e).sum(axis=1))
        return {
            "samples": len(self.t_k), "horizon": float(self.t[-1]), "multiplier_measured": self.multiplier,
            "multiplier_proved": self.stated, "error_first": float(sizes[0]), "error_final": float(sizes[-1]),
        }  # fmt: skip


def replay(inclusion: HybridInclusion, witness: Witness) -> Replay:
    """Run a `constant` or `switching` witness of the class, or a `vector` that is an error's direction.

    The word is repeated until the error has grown a hundredfold, at least 6 and at most 60 times. The
    measured multiplier is |w'e| after one word over |w'e| before, w the left eigenvector of M: for a complex
    pair |e| itself swings. An unseen direction is itself the start, |e| is measured, and 6 words are enough.

    Raises:
        UsageError: another kind of witness, or one that is not of this inclusion.
    """
    from scipy.linalg import expm

    from cdobs_cli.certify.words import Word, is_about

    if inclusion.sampling.is_random:
        raise UsageError("samples are lost by chance: the mean square of the error grows, which one run does not show")
    unseen = witness.kind == "vector" and "direction" in witness.data
    if not unseen and (witness.kind not in ("constant", "switching") or witness.about != "class"):
        of = f"a witness of kind {witness.kind} (about the {witness.about})"
        raise UsageError(f"{of} has no V(t) to run; constant and switching have")
    try:
        word = Word.from_witness(witness)
    except (ValueError, KeyError, TypeError, ExpressionError) as error:
        raise UsageError(f"a witness that cannot be read: {error}") from error
    if not is_about(witness, inclusion) or any(len(row) != len(inclusion.entries) for row in witness.values):
        raise UsageError("a witness of other slopes than this design's; run `cdobs check` again")
    phases = inclusion.phases_floats
    size = phases[0].base.shape[0]
    # One word, as arcs (times from the arc's start, exponentials at them, slopes) and the jump that follows.
    arcs: list[tuple[Array, Array, Array, Array | None]] = []
    M = np.eye(size)
    for (period, w), maps in zip(word.samples, word.jumps(phases), strict=True):
        J = np.eye(size) if maps is None else maps.jump_at(tuple(map(float, w)))
        for position, arc in enumerate(period):
            v = np.array([float(value) for value in arc.values])
            times = np.linspace(0.0, float(arc.length), _POINTS)
            flow = np.array([expm(phases[0].flow(tuple(v)) * s) for s in times])
            jumps = position == len(period) - 1
            arcs.append((times, flow, v, J if jumps else None))
            M = (J @ flow[-1] if jumps else flow[-1]) @ M
    values, left, right = _eigen(M)
    growth = abs(values)
    if unseen:
        right = _direction(witness, size)
        growth = float(witness.multiplier or 1)
    words = _MOST if growth <= 1.0 + 1e-9 else int(np.clip(np.ceil(np.log(_GROWTH) / np.log(growth)), _FEWEST, _MOST))
    if unseen:
        words = min(words, _FEWEST)  # what rounding adds grows with any other error
    e, start = right, 0.0
    size_of = np.linalg.norm if unseen else lambda e: abs(np.vdot(left, e))
    t, states, slopes, samples = [], [], [], [0.0]
    for _ in range(words):
        before = size_of(e)
        for times, flow, v, jump in arcs:
            t.append(start + times)
            states.append(flow @ e)
            slopes.append(np.tile(v, (_POINTS, 1)))
            e, start = flow[-1] @ e, start + float(times[-1])
            if jump is not None:
                e = jump @ e
                samples.append(start)
        multiplier = float(size_of(e) / before)
    t.append(np.array([start]))
    states.append(e[None])
    slopes.append(slopes[-1][-1:])
    run = np.concatenate(t), np.concatenate(states), np.concatenate(slopes), np.array(samples)
    return Replay(*run, inclusion.entries, multiplier, witness.multiplier)


def _direction(witness: Witness, size: int) -> Array:
    """The error's direction, of size 1; further states (held innovations) start at 0.

    Raises:
        UsageError: it cannot be read, or is of another plant.
    """
    try:
        entries = [float(Exact(text)) for text in witness.data["direction"]]
    except (TypeError, ValueError, ZeroDivisionError, OverflowError, ExpressionError) as error:
        raise UsageError(f"a witness that cannot be read: {error}") from error
    length = float(np.linalg.norm(entries))
    if not 0 < length < np.inf or len(entries) > size:
        raise UsageError("a witness of another plant than this design's; run `cdobs check` again")
    return np.concatenate([np.array(entries) / length, np.zeros(size - len(entries))])


def _eigen(M: Array) -> tuple[complex, Any, Array]:
    """The eigenvalue of largest modulus, its left eigenvector, and a real start in its invariant space, of size 1."""
    from scipy.linalg import eig

    values, left, right = eig(M, left=True, right=True)  # type: ignore[misc]
    largest = int(np.argmax(np.abs(values)))
    start = np.real(right[:, largest])
    if np.linalg.norm(start) < 0.1 * np.linalg.norm(right[:, largest]):
        start = np.imag(right[:, largest])
    return complex(values[largest]), left[:, largest], start / np.linalg.norm(start)
