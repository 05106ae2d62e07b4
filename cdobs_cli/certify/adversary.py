"""The lower end of an error bound: slopes, disturbance and noise inside what is declared that make an error this large.

A word is a sequence of sampling periods, each of arcs of constant slopes V and disturbance d, with the noise v (and the
slopes w of the outputs) of the sample that ends it:

    edot = A(V) e + B d on an arc,    e+ = J(w) e + G v at the sample.

Over the word e -> M e + c. Repeated for ever, with rho(M) < 1, the error tends from every start to the one periodic
solution, e* = (I - M)^-1 c at its seam; so limsup |e_i| is at least |e_i| at any point of that solution, and no bound
of the error below it is true. The signals are taken from the declared boxes themselves, symmetric or not. Floats
search (`adversary_search`), balls prove.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import Any, Literal

from flint import arb

from cdobs_cli.certificate import Witness
from cdobs_cli.certify.ball import has_spectral_radius_below, is_finite
from cdobs_cli.certify.words import Arc, Word, is_about, is_admissible, output_texts
from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import Exact, lower_text
from cdobs_cli.hybrid import HybridInclusion
from cdobs_cli.plant import Box
from cdobs_cli.records import dataclass

KIND: Literal["noise"] = "noise"
Signal = tuple[Exact, ...]


@dataclass(frozen=True)
class NoisyWord:
    """word: periods, arcs and their slopes. d: of each arc, v: of the sample that ends each period. state: whose error
    is looked at; at: after so many arcs; after: just after the sample there, not just before it."""

    word: Word
    d: tuple[Signal, ...]
    v: tuple[Signal, ...]
    state: int
    at: int
    after: bool = False

    def steps(self) -> Iterator[tuple[int, Arc, Signal, tuple[Signal, Signal] | None]]:
        """Each arc: how many have gone at its end, itself, its d; and (w, v) of the sample at its end, where one is."""
        number = 0
        for (period, w), v in zip(self.word.samples, self.v, strict=True):
            for position, arc in enumerate(period):
                number += 1
                ends = position == len(period) - 1
                yield number, arc, self.d[number - 1], (w, v) if ends else None

    def witness(self, inclusion: HybridInclusion, reached: arb) -> Witness:
        """As data: arc lengths and slopes; in `data` how many arcs each period has, d of each arc, v of each sample,
        and where the error of which state reaches what."""
        arcs = [arc for period in self.word.periods for arc in period]
        data: dict[str, Any] = {
            "arcs": [len(period) for period in self.word.periods],
            "d": [[str(value) for value in d] for d in self.d], "v": [[str(value) for value in v] for v in self.v],
            "state": self.state, "at": self.at, "after": self.after, "reached": lower_text(reached, 6),
        }  # fmt: skip
        if inclusion.outputs:
            data["outputs"] = output_texts(inclusion, self.word.outputs)
        varies = bool(inclusion.quantities or inclusion.outputs)
        return Witness(
            KIND, "class" if varies else "plant", tuple(str(arc.length) for arc in arcs),
            tuple(tuple(str(value) for value in arc.values) for arc in arcs), None, inclusion.entries, data,
        )  # fmt: skip

    @staticmethod
    def from_witness(witness: Witness) -> NoisyWord:
        """Raises: ValueError, KeyError, TypeError, ExpressionError on what `witness` did not write."""
        word, data = Word.from_witness(witness), witness.data
        d, v = (tuple(tuple(map(Exact, row)) for row in data[name]) for name in ("d", "v"))
        if len(d) != len(witness.times) or len(v) != len(word.periods):
            raise ValueError("one d an arc, one v a sample")
        return NoisyWord(word, d, v, int(data["state"]), int(data["at"]), bool(data["after"]))


def attained(inclusion: HybridInclusion, state: int, effort: int) -> tuple[arb, Witness] | None:
    """A proved lower end of limsup |e_i| under what is declared, and the word that attains it; None where none is
    found. Loads no solver."""
    from cdobs_cli.certify.adversary_search import propose

    for proposal in propose(inclusion, state, effort):
        reached = prove(inclusion, proposal)
        if reached is not None and reached > 0:
            return reached, proposal.witness(inclusion, reached)
    return None


def attains(inclusion: HybridInclusion, witness: Witness) -> arb | None:
    """What a stored witness attains of this inclusion; None where it is not one of it."""
    if witness.kind != KIND or not is_about(witness, inclusion):
        return None
    try:
        return prove(inclusion, NoisyWord.from_witness(witness))
    except (ValueError, KeyError, TypeError, IndexError, ExpressionError):
        return None


def prove(inclusion: HybridInclusion, noisy: NoisyWord) -> arb | None:
    """A lower bound of |e_i| on the periodic solution of an admissible word; None where that is not proved."""
    if not _is_admissible(inclusion, noisy) or not 0 <= noisy.state < inclusion.plant.n:
        return None
    flow = _Flow(inclusion)
    N = flow.size
    total, there = Matrix.identity(N + 1), None
    for number, arc, d, sample in noisy.steps():
        total = flow.arc(arc, d) @ total
        if number == noisy.at and not noisy.after:
            there = total
        if sample is not None:
            total = flow.sample(*sample) @ total
        if number == noisy.at and noisy.after:
            there = total
    rows = list(range(N))
    M, c = total[rows, rows], total[rows, [N]]
    if there is None or not is_finite(total) or not has_spectral_radius_below(M):
        return None
    try:
        seam = (Matrix.identity(N) - M).solve(c)
    except ZeroDivisionError:
        return None
    reached = arb((there[[noisy.state], rows] @ seam + there[[noisy.state], [N]])[0, 0]).abs_lower()
    return reached if reached.is_finite() else None


@dataclass(frozen=True)
class _Flow:
    """Affine maps of (e, 1), in balls. Shapes: (N + 1, N + 1)."""

    inclusion: HybridInclusion

    @cached_property
    def _maps(self) -> Any:
        return self.inclusion.balls

    @cached_property
    def _noise(self) -> Any:
        return self.inclusion.noise_balls

    @cached_property
    def _known(self) -> dict[Any, Matrix]:
        return {}

    @property
    def size(self) -> int:
        """N."""
        return int(self._maps.base.shape[0])

    def arc(self, arc: Arc, d: Signal) -> Matrix:
        """exp([[A(V), B d], [0, 0]] length)."""
        if (arc, d) not in self._known:
            A = self._maps.flow(tuple(value.scalar for value in arc.values))
            self._known[arc, d] = _affine(A, self._noise.drive @ _column(d), 0).exp(arc.length.scalar)
        return self._known[arc, d]

    def sample(self, w: Signal, v: Signal) -> Matrix:
        """[[J(w), G v], [0, 1]]."""
        J = self._maps.jump_at(tuple(value.scalar for value in w))
        return _affine(J, self._noise.kick @ _column(v), 1).balls()


def _affine(M: Matrix, c: Matrix, corner: int) -> Matrix:
    below = Matrix.from_rows([[0] * M.shape[0]])
    return block([[M, c], [below, Matrix.from_rows([[corner]])]])


def _column(values: Signal) -> Matrix:
    return Matrix.from_rows([[value.scalar] for value in values])


def _is_admissible(inclusion: HybridInclusion, noisy: NoisyWord) -> bool:
    """Whether slopes, signals and periods certainly lie in what is declared."""
    plant = inclusion.plant
    if not all(is_admissible(inclusion, *sample) for sample in noisy.word.samples):
        return False
    arcs = sum(len(period) for period in noisy.word.periods)
    if len(noisy.d) != arcs or len(noisy.v) != len(noisy.word.periods) or not 1 <= noisy.at <= arcs:
        return False
    return all(_is_in(plant.disturbance, d, plant.n) for d in noisy.d) and all(
        _is_in(plant.noise, v, plant.p) for v in noisy.v
    )


def _is_in(box: Box | None, values: Signal, size: int) -> bool:
    if len(values) != size:
        return False
    if box is None:
        return all(value.sign() == 0 for value in values)
    ends = zip(box.lower, values, box.upper, strict=True)
    return all(low.is_at_most(value) and value.is_at_most(high) for low, value, high in ends)
