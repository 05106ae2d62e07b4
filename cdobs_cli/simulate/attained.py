"""A counterexample to an error bound run again: the error under the witness's slopes, disturbance and noise.

    edot = A(V) e + B d on an arc,    e+ = J(w) e + G v at a sample,    e(0) = 0,

the word repeated until the error follows its periodic solution. Within an arc V and d are constant, so every point is
an affine map away from the arc's start.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cdobs_cli.arrays import Array
from cdobs_cli.certificate import Witness
from cdobs_cli.certify.adversary import KIND, NoisyWord
from cdobs_cli.certify.words import is_about
from cdobs_cli.errors import UsageError
from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.hybrid import HybridInclusion
from cdobs_cli.records import dataclass

_POINTS = 12  # of an arc
_CLOSE = 1e-9  # of what a word still remembers of its start
_FEWEST, _MOST = 2, 60  # repetitions of the word


@dataclass(frozen=True)
class AttainedReplay:
    """The run of a witness of kind `noise`.

    t (N,) holds both sides of each jump and each switch (equal t twice); e (N, size of the error); V (N, number of
    uncertain slopes), in the order of `entries`; d (N, n); t_k (K,) the samples; v (K, p) their noise, that of the
    first, at 0, being 0. at (M,): where in t the error of state number `state` is to be as large as was proved.
    """

    t: Array
    e: Array
    V: Array
    d: Array
    t_k: Array
    v: Array
    entries: tuple[tuple[int, int], ...]
    state: int
    at: NDArray[np.int64]
    proved: str

    def arrays(self) -> dict[str, NDArray[Any]]:
        """For an .npz beside the simulation's."""
        entries = np.array(self.entries, dtype=np.int64).reshape(len(self.entries), 2)
        signals = {"d": self.d, "t_k": self.t_k, "v": self.v}
        return {"t": self.t, "e": self.e, "V": self.V, **signals, "entries": entries, "at": self.at}

    @property
    def measured(self) -> float:
        """|e_i| at the last of these points."""
        return float(abs(self.e[self.at[-1], self.state]))

    def document(self) -> dict[str, Any]:
        """The figures of the run."""
        return {
            "samples": len(self.t_k), "horizon": float(self.t[-1]), "state": self.state,
            "error_proved": self.proved, "error_measured": self.measured,
        }  # fmt: skip


def replay_attained(inclusion: HybridInclusion, witness: Witness) -> AttainedReplay:
    """Run a witness of kind `noise`.

    Raises:
        UsageError: another kind of witness, or one that is not of this inclusion.
    """
    if witness.kind != KIND:
        raise UsageError(f"a witness of kind {witness.kind} has no noise to run")
    try:
        noisy, proved = NoisyWord.from_witness(witness), str(witness.data["reached"])
    except (ValueError, KeyError, TypeError, ExpressionError) as error:
        raise UsageError(f"a witness that cannot be read: {error}") from error
    if not is_about(witness, inclusion) or not _fits(inclusion, noisy):
        raise UsageError("a witness of another plant than this design's; run `cdobs check` again")
    legs = list(_legs(inclusion, noisy))
    words = _words(legs, inclusion)
    e, start = np.zeros(inclusion.floats.base.shape[0]), 0.0
    t, states, samples, at = [], [], [0.0], []
    for _ in range(words):
        for leg in legs:
            t.append(start + leg.times)
            states.append(leg.run(e))
            e, start = states[-1][-1], start + float(leg.times[-1])
            if leg.sample is not None:
                e = leg.sample.J @ e + leg.sample.fall
                samples.append(start)
            if leg.number == noisy.at:
                at.append(len(t) * _POINTS - (not noisy.after))
    rows = [leg for leg in legs for _ in range(_POINTS)] * words
    rows.append(rows[-1])
    kicks = [leg.sample.v for leg in legs if leg.sample is not None] * words
    return AttainedReplay(
        np.array([*np.concatenate(t), start]), np.array([*np.concatenate(states), e]),
        np.array([leg.V for leg in rows]), np.array([leg.d for leg in rows]), np.array(samples),
        np.array([0 * kicks[0], *kicks]), inclusion.entries, noisy.state, np.array(at, dtype=np.int64), proved,
    )  # fmt: skip


@dataclass(frozen=True)
class _Sample:
    """e+ = J e + fall, fall = G v."""

    J: Array
    fall: Array
    v: Array


@dataclass(frozen=True)
class _Leg:
    """One arc: times from its start (k,), affine maps (k, N + 1, N + 1) to them, and the sample at its end, if any."""

    number: int
    times: Array
    flow: Array
    V: Array
    d: Array
    sample: _Sample | None

    def run(self, e: Array) -> Array:
        """The errors at the times, from e, shape (k, N)."""
        N = len(e)
        errors: Array = self.flow[:, :N, :N] @ e + self.flow[:, :N, N]
        return errors


def _legs(inclusion: HybridInclusion, noisy: NoisyWord) -> Iterator[_Leg]:
    from scipy.linalg import expm

    maps, noise = inclusion.floats, inclusion.noise_floats
    N = maps.base.shape[0]
    for number, arc, d, sample in noisy.steps():
        V, signal, affine = _floats(arc.values), _floats(d), np.zeros((N + 1, N + 1))
        affine[:N, :N], affine[:N, N] = maps.flow(tuple(V)), noise.drive @ signal
        times = np.linspace(0.0, float(arc.length), _POINTS)
        met = None
        if sample is not None:
            w, v = _floats(sample[0]), _floats(sample[1])
            met = _Sample(maps.jump_at(tuple(w)), noise.kick @ v, v)
        yield _Leg(number, times, np.array([expm(affine * s) for s in times]), V, signal, met)


def _words(legs: list[_Leg], inclusion: HybridInclusion) -> int:
    """Repetitions after which next to nothing is left of the start."""
    N = inclusion.floats.base.shape[0]
    M = np.eye(N)
    for leg in legs:
        M = leg.flow[-1, :N, :N] @ M
        M = M if leg.sample is None else leg.sample.J @ M
    radius = float(np.abs(np.linalg.eigvals(M)).max(initial=0.0))
    if radius >= 1:
        return _MOST
    return int(np.clip(np.ceil(np.log(_CLOSE) / np.log(max(radius, 1e-300))), _FEWEST, _MOST))


def _floats(values: tuple[Exact, ...]) -> Array:
    return np.array([float(value) for value in values])


def _fits(inclusion: HybridInclusion, noisy: NoisyWord) -> bool:
    """Whether slopes and signals are of the plant's sizes, and the point looked at is one of the word."""
    plant, arcs = inclusion.plant, [arc for period in noisy.word.periods for arc in period]
    sizes = all(len(arc.values) == len(inclusion.entries) for arc in arcs)
    signals = all(len(d) == plant.n for d in noisy.d) and all(len(v) == plant.p for v in noisy.v)
    return sizes and signals and 0 <= noisy.state < plant.n and 1 <= noisy.at <= len(arcs)
