"""Words: a slope history V(t) inside the box and sampling periods inside the law, repeated for ever, that an error does
not survive; how they are stored, and their proof.

Over a word of sampling periods the error is multiplied by the monodromy matrix

    M = J Phi_m .. J Phi_1,    Phi = product of exp((base + sum_k v_k parts_k) s) over the arcs of a period;

of sensors with periods of their own with the J of each sample in turn, over whole hyperperiods, or as the word tells.
Repeated for ever it keeps some error from converging when rho(M) >= 1. Where outputs have slopes that vary each J is
one of the class, chosen at each sample. Balls prove. A word is about the slope class: some plant with these slopes
defeats the gain.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

from flint import arb

from cdobs_cli.certificate import Witness
from cdobs_cli.certify.ball import (
    has_eigenvalue_beyond,
    has_spectral_radius_at_least,
    is_hurwitz,
    null_space,
    spectral_radius_lower,
)
from cdobs_cli.certify.symmetric_power import power
from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import Exact, lower_text
from cdobs_cli.exact.rational import simplify
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion
from cdobs_cli.plant import Quantity
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

M_ = TypeVar("M_")


@dataclass(frozen=True)
class Arc:
    """A constant slope vector (order: `inclusion.entries`) kept for `length` time units."""

    length: Exact
    values: tuple[Exact, ...]


@dataclass(frozen=True)
class Word:
    """Sampling periods, each a sequence of arcs; repeated for ever.

    outputs: the slopes of the outputs that vary (order: `inclusion.outputs`) at the sample that ends each period; empty
    where none does. readings: what is read at the end of each period, where a timed graph tells what may be: None where
    nothing arrives."""

    periods: tuple[tuple[Arc, ...], ...]
    outputs: tuple[tuple[Exact, ...], ...] = ()
    readings: tuple[int | None, ...] = ()

    @property
    def samples(self) -> Iterator[tuple[tuple[Arc, ...], tuple[Exact, ...]]]:
        """Each period with the slopes of the outputs at its end."""
        return zip(self.periods, self.outputs or ((),) * len(self.periods), strict=True)

    def witness(self, inclusion: HybridInclusion, multiplier: arb) -> Witness:
        """The word as data: arc lengths, slope values, and how many arcs each sampling period has."""
        arcs = [arc for period in self.periods for arc in period]
        data: dict[str, Any] = {"arcs": [len(period) for period in self.periods]}
        if inclusion.outputs:
            data["outputs"] = output_texts(inclusion, self.outputs)
        if self.readings:
            data["readings"] = list(self.readings)
        return Witness(
            "constant" if len(arcs) == 1 else "switching",
            "class",
            tuple(str(arc.length) for arc in arcs),
            tuple(tuple(str(value) for value in arc.values) for arc in arcs),
            lower_text(multiplier),
            inclusion.entries,
            data,
        )

    @staticmethod
    def from_witness(witness: Witness) -> Word:
        """Raises: ValueError, KeyError, TypeError, ExpressionError on what `witness` did not write."""
        arcs = [
            Arc(Exact(t), tuple(Exact(v) for v in values))
            for t, values in zip(witness.times, witness.values, strict=True)
        ]
        counts = [int(count) for count in witness.data["arcs"]]
        if sum(counts) != len(arcs) or min(counts, default=0) < 1:
            raise ValueError("the arcs of a word fill its sampling periods")
        starts = [sum(counts[:k]) for k in range(len(counts))]
        periods = tuple(tuple(arcs[start : start + count]) for start, count in zip(starts, counts, strict=True))
        columns = [[Exact(text) for text in column["values"]] for column in witness.data.get("outputs", ())]
        outputs = tuple(zip(*columns, strict=True))
        if columns and len(outputs) != len(periods):
            raise ValueError("outputs have one slope at each sample")
        readings = tuple(witness.data.get("readings", ()))
        if any(one is not None and type(one) is not int for one in readings) or len(readings) not in (0, len(periods)):
            raise ValueError("a reading ends each period")
        return Word(periods, outputs, readings)

    def jumps(self, phases: Sequence[ErrorMaps[M_]]) -> Iterator[ErrorMaps[M_] | None]:
        """The maps of the sample that ends each period, of those of all readings: in turn, or as the word tells; None
        where nothing arrives. Raises: IndexError."""
        if self.readings:
            yield from (None if one is None else phases[one] for one in self.readings)
        else:
            yield from (phases[k % len(phases)] for k in range(1, len(self.periods) + 1))


def output_texts(inclusion: HybridInclusion, outputs: tuple[tuple[Exact, ...], ...]) -> list[dict[str, Any]]:
    """The slopes of the outputs at the samples of a word, as data: of each its entry, from 0, and its values."""
    columns = zip(inclusion.outputs, zip(*outputs, strict=True), strict=True)
    return [{"entry": list(rho.entry), "values": [str(value) for value in values]} for rho, values in columns]


def is_about(witness: Witness, inclusion: HybridInclusion) -> bool:
    """Whether a witness is about these slopes, of the flow and of the outputs."""
    seen = witness.data.get("outputs", ())
    if not isinstance(seen, list | tuple) or not all(isinstance(column, Mapping) for column in seen):
        return False
    of_outputs = [list(column.get("entry", ())) for column in seen]
    return witness.entries == inclusion.entries and of_outputs == [list(rho.entry) for rho in inclusion.outputs]


def refutes(inclusion: HybridInclusion, witness: Witness) -> bool:
    """Whether a stored witness defeats this inclusion: slopes in the box, periods in the law, rho(M) >= 1."""
    if witness.kind not in ("constant", "switching") or not is_about(witness, inclusion):
        return False
    try:
        word = Word.from_witness(witness)
    except (ValueError, KeyError, TypeError, ExpressionError):
        return False
    return prove(inclusion, word) is not None


def prove(inclusion: HybridInclusion, word: Word) -> arb | None:
    """A lower bound of rho(M) where rho(M) >= 1 is proved for an admissible word; None otherwise. Where samples are
    lost by chance the word is one period of constant slopes, and M is what a sample makes of E e e'."""
    if inclusion.sampling.is_random:
        return _prove_in_the_mean(inclusion, word)
    if not all(is_admissible(inclusion, *sample, k) for k, sample in enumerate(word.samples)):
        return None
    phases = inclusion.phases_balls
    if not _is_repeated(inclusion.sampling, word):
        return None
    M = monodromy(phases, word)
    if not has_spectral_radius_at_least(M):
        values = {(arc.values, w) for period, w in word.samples for arc in period}
        return arb(1) if len(values) == 1 and leaves_unseen(inclusion, *values.pop()) else None
    bound = spectral_radius_lower(M)
    return bound if bound > 1 else arb(1)


def _is_repeated(law: SamplingLaw, word: Word) -> bool:
    """Whether a word whose periods are admissible one by one may follow itself."""
    if law.is_graph:
        return law.repeats([_length(period) for period in word.periods], word.readings)
    return not word.readings and len(word.periods) % max(1, len(law.phases)) == 0


def _prove_in_the_mean(inclusion: HybridInclusion, word: Word) -> arb | None:
    samples = list(word.samples)
    if len(samples) != 1 or len(samples[0][0]) != 1:
        return None
    ((arc,), w), law = samples[0], inclusion.sampling
    alike = are_within(arc.values, inclusion.quantities) and are_within(w, inclusion.outputs)
    if not alike or not (arc.length == law.T_min or (arc.length - law.T_min).sign() == 0):
        return None
    maps, p = inclusion.balls, law.probability.scalar
    F = maps.flow(tuple(value.scalar for value in arc.values)).exp(arc.length.scalar)
    JF = maps.jump_at(tuple(value.scalar for value in w)) @ F
    kept, lost = (Matrix.from_rows(power(M.balls().tolist(), 2)) for M in (JF, F))
    return arb(1) if has_eigenvalue_beyond((kept * (1 - p) + lost * p).balls()) else None


def monodromy(phases: Sequence[ErrorMaps[Matrix]], word: Word) -> Matrix:
    """M = J Phi_m .. J Phi_1 in balls, the J of samples in turn; the first arc begins at the first of them."""
    total = Matrix.identity(phases[0].base.shape[0])
    for (period, w), maps in zip(word.samples, word.jumps(phases), strict=True):
        for arc in period:
            total = phases[0].flow(tuple(value.scalar for value in arc.values)).exp(arc.length.scalar) @ total
        if maps is not None:
            total = maps.jump_at(tuple(value.scalar for value in w)) @ total
    return total


def is_admissible(inclusion: HybridInclusion, period: tuple[Arc, ...], w: tuple[Exact, ...], number: int = 0) -> bool:
    """Whether the slopes certainly lie in the box, and the arcs fill a period of the law, of a word's periods the one
    of this number."""
    if not are_within(w, inclusion.outputs):
        return False
    law = inclusion.sampling
    signs = (0, 1) if law.is_graph and len(period) == 1 else (1,)  # sensors that keep no step may be read at once
    if any(arc.length.sign() not in signs or not are_within(arc.values, inclusion.quantities) for arc in period):
        return False
    if law.is_graph:  # which periods may follow one another is asked of the whole word
        return True
    length = _length(period)
    if law.is_multirate:
        gap = law.gaps[number % len(law.phases)]
        return length == gap or (length - gap).sign() == 0
    return law.allows(length)


def _length(period: tuple[Arc, ...]) -> Exact:
    """Of all arcs together."""
    length = period[0].length
    for arc in period[1:]:
        length = length + arc.length
    if len(period) > 1 and length.rational is None:  # balls cannot tell a period from the arcs that it is made of
        length = Exact(simplify(length.expression))
    return length


def are_within(values: tuple[Exact, ...], quantities: tuple[Quantity, ...]) -> bool:
    """Whether each value certainly lies between the ends of its quantity."""
    if len(values) != len(quantities):
        return False
    return all(rho.lower.is_at_most(v) and v.is_at_most(rho.upper) for v, rho in zip(values, quantities, strict=True))


def leaves_unseen(inclusion: HybridInclusion, values: tuple[Exact, ...], w: tuple[Exact, ...]) -> bool:
    """Whether constant slopes, of the flow and of the outputs, make some error that never shows in the outputs and does
    not decay: then no gain and no sampling law helps. Exact, for rational data: A + V on the unobservable subspace is
    not Hurwitz, and flow and jump keep that subspace."""
    phases, C = inclusion.phases_balls, inclusion.plant.output_matrix(w).balls()
    jumps = [maps.jump_at(tuple(value.scalar for value in w)) for maps in phases]
    F = phases[0].flow(tuple(value.scalar for value in values))
    A = inclusion.view_balls.flow(value.scalar for value in values) if inclusion.quantities else inclusion.view_balls.A
    if not (F.is_rational and C.is_rational and A.is_rational and all(J.is_rational for J in jumps)):
        return False
    basis = unobservable_subspace(A, C)
    if basis is None:
        return False
    size = basis.shape[1]
    kept = (basis.T @ basis).solve(basis.T @ A @ basis)  # A N = N kept
    embedded = block([[basis], [Matrix.zeros(F.shape[0] - A.shape[0], size)]]) if F.shape[0] > A.shape[0] else basis
    stays = (F @ embedded - embedded @ kept).data == Matrix.zeros(F.shape[0], size).data
    if not stays or any((J @ embedded).data != embedded.data for J in jumps):
        return False
    return not is_hurwitz(kept)


def unobservable_subspace(A: Matrix, C: Matrix) -> Matrix | None:
    """A basis (n, u) of the errors that C exp(A t) never shows, for rational A and C; None where there is none."""
    rows, power = C, C
    for _ in range(A.shape[0] - 1):
        power = power @ A
        rows = block([[rows], [power]])
    return null_space(rows)
