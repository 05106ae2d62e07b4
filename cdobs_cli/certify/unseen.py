"""Errors that no measurement ever shows and that do not decay: then no gain helps, of this observer or any other.

With constant slopes V of the class, F = A + V, two plants that differ by e(0) = v differ by exp(F t) v for ever.

1. C exp(F t) v = 0 for all t: v in the unobservable subspace of (F, C), and F on it is not Hurwitz. No law helps.
2. C exp(F k T) v = 0 for all samples k T of one period T of the law: pathological sampling. For an eigenvalue
   a + i w of F with (F - a)^2 + w^2 = 0 on a space W, exp(F T) has the eigenvalues exp(a T) exp(+- i w T) there and
   is diagonalisable. Spaces of one a >= 0 whose angles w T agree modulo 2 pi, up to sign, join to E:
   - w T = 0 or pi modulo 2 pi: exp(F T) = +-exp(a T) I on E, so every v of E with C v = 0 is unseen at all
     samples; there are some where dim E > rank of C on E;
   - else exp(F T) obeys a quadratic equation on E, and C v = C exp(F T) v = 0 is enough: there are some where
     dim E > 2 rank of C on E.
3. The same of sensors with periods T_i of their own: with E all spaces of one a >= 0 and E_g those whose angles w T_i
   agree for sensor i, it sees at most sum_g rank of C_i on E_g (twice where the angle is not 0 or pi) dimensions; where
   angle and offset are 0 or pi, those of C_i on E_g itself, which sensors may have in common. Some v of E is unseen by
   all of them where dim E is more than that in all.

A correction K (y - C x_hat) or a held innovation L (y - C x_hat) is 0 for such an error. All of it is rational
linear algebra: F and C may have one irrational factor each, and T one such that w T / pi is rational.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from fractions import Fraction
from itertools import islice, product
from typing import Any, NamedTuple, TypeVar

from flint import arb

from cdobs_cli.certificate import Witness
from cdobs_cli.certify.ball import is_hurwitz, null_space
from cdobs_cli.certify.words import unobservable_subspace
from cdobs_cli.exact.expression import ExpressionError
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text, fmpq_fraction, fraction_text, lower_text
from cdobs_cli.exact.rational import is_zero, simplify
from cdobs_cli.plant import Plant, Quantity
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import Sensor

S_ = TypeVar("S_")
T_ = TypeVar("T_")

_CORNERS = 32
_DENOMINATOR = 10**6
_PI = Exact("pi")
_ONE = Exact(1)


@dataclass(frozen=True)
class Unseen:
    """An error direction that is never seen at the samples and does not decay.

    values: constant slopes, in the order of `plant.slopes.quantities`. outputs: constant slopes of the outputs that
    vary. period: a constant period of the law at
    which it is unseen; None where it is unseen at all times. factor: the error's growth from sample to sample, at
    least (None where it is unseen at all times).
    """

    values: tuple[Exact, ...]
    period: Exact | None
    direction: tuple[Fraction, ...]
    factor: str | None
    outputs: tuple[Exact, ...] = ()

    def witness(self, plant: Plant) -> Witness:
        """The direction, with the slopes and the period it goes with, enough for a replay."""
        entries = tuple(rho.entry for rho in plant.slopes.quantities)
        T = self.period or plant.sampling.T_max
        times = plant.sampling.gaps or (T,)
        data: dict[str, Any] = {
            "arcs": [1] * len(times),
            "direction": [fraction_text(value) for value in self.direction],
            "states": list(plant.states),
        }
        if self.outputs:
            columns = zip(plant.output_quantities, self.outputs, strict=True)
            data["outputs"] = [
                {"entry": list(rho.entry), "values": [str(value)] * len(times)} for rho, value in columns
            ]
        return Witness(
            "vector",
            "class" if entries or self.outputs else "plant",
            tuple(map(str, times)),
            (tuple(map(str, self.values)),) * len(times),
            self.factor,
            entries,
            data,
        )

    def sentence(self, plant: Plant) -> str:
        """Why no gain helps, in the names of the states."""
        quantities = (*plant.slopes.quantities, *plant.output_quantities)
        values = zip((*self.values, *self.outputs), quantities, strict=True)
        slopes = ", ".join(f"{rho.text(plant.states)} = {_short(value)}" for value, rho in values)
        where = f" with {slopes}" if slopes else ""
        direction = _combination(self.direction, plant.states)
        if self.period is None:
            seen = f"no measurement ever shows an error along {direction}{where}, and it does not decay"
            return f"the plant is not detectable: {seen}, so no gain helps; measure another quantity"
        law = plant.sampling
        sampled = law.words if law.has_sensors else f"every {self.period}"
        seen = f"sampled {sampled}, no measurement shows an error along {direction}{where}, and it does not decay"
        return f"the sampled plant is not detectable: {seen}, so no gain helps; another period may"


def unseen(plant: Plant, law: SamplingLaw | None = None) -> Unseen | None:
    """An unseen error for some constant slopes of the class under the law (default: the plant's own), proved.

    At the corners of the slope box (some of them), its middle, and the slopes nearest to 0; those of outputs alike.
    None says nothing.
    """
    law = law or plant.sampling
    if law.is_random:  # what no sample shows is not shown by those that arrive
        law = SamplingLaw.periodic(law.period)
    if not (law.is_bounded or law.has_sensors or law.is_on_change):
        return None
    found, at_samples_of = [], _at_sensors if law.is_multirate else _at_samples
    seen = [(w, _factored(plant.output_matrix(w))) for w in _candidates(plant.output_quantities)]
    for values, (w, C) in _pairs(list(_candidates(plant.slopes.quantities)), seen):
        F = None if C is None else _factored(_flow(plant, values))
        if F is None or C is None:
            continue
        always = _always(F[1], C[1])
        if always is not None:
            return Unseen(values, None, always, None, w)
        found.append((values, w, F, C))
    if law.is_graph or law.is_on_change:
        return None
    for values, w, F, C in found:
        at_samples = at_samples_of(F, C[1], law)
        if at_samples is not None:
            T, direction, factor = at_samples
            return Unseen(values, T, direction, factor, w)
    return None


def _pairs(slopes: list[S_], outputs: list[T_]) -> Iterator[tuple[S_, T_]]:
    """All of the one with the first two (middle, nearest to 0) of the other."""
    for (i, values), (k, seen) in product(enumerate(slopes), enumerate(outputs)):
        if min(i, k) < 2:
            yield values, seen


def _candidates(quantities: tuple[Quantity, ...]) -> Iterator[tuple[Exact, ...]]:
    """Middle, nearest to 0, corners; each once."""
    ends = [(rho.lower, rho.upper) for rho in quantities]
    half = Exact(Fraction(1, 2))
    middle = tuple((low + high) * half for low, high in ends)
    nearest = tuple(low if low.sign() == 1 else high if high.sign() == -1 else Exact(0) for low, high in ends)
    made = dict.fromkeys((middle, nearest, *islice(product(*ends), _CORNERS)))
    for values in made:
        if all(_at_most(low, value) and _at_most(value, high) for value, (low, high) in zip(values, ends, strict=True)):
            yield values


def _flow(plant: Plant, values: tuple[Exact, ...]) -> ExactMatrix:
    """A + V, the constant slopes included."""
    rows = [
        [value + plant.slopes.constant((i, j)) for j, value in enumerate(row)] for i, row in enumerate(plant.A.rows)
    ]
    for value, rho in zip(values, plant.slopes.quantities, strict=True):
        for (i, j), weight in rho.weights:
            rows[i][j] = rows[i][j] + weight * value
    return ExactMatrix(rows)


def _factored(matrix: ExactMatrix) -> tuple[Exact, Matrix] | None:
    """(c, M) with matrix = c M, c > 0 and M rational, exactly so; None where no such c is seen."""
    entries = [entry for row in matrix.rows for entry in row]
    odd = next((entry for entry in entries if entry.rational is None), None)
    if odd is None:
        return _ONE, matrix.balls()
    c = odd if odd.sign() == 1 else -odd
    if c.sign() != 1:
        return None
    rows = [[_ratio(entry, c) for entry in row] for row in matrix.rows]
    if any(value is None for row in rows for value in row):
        return None
    return c, Matrix.from_rows([[value for value in row if value is not None] for row in rows])


def _ratio(x: Exact, y: Exact) -> Fraction | None:
    """x / y where that is rational of a small denominator, proved as an identity."""
    if x.sign() == 0:
        return Fraction(0)
    quotient = float((x.ball() / y.ball()).mid())
    if not math.isfinite(quotient):
        return None
    try:
        q = Fraction(quotient).limit_denominator(_DENOMINATOR)
        return q if q != 0 and is_zero((x - Exact(q) * y).expression) else None
    except (ExpressionError, OverflowError):
        return None


def _always(F: Matrix, C: Matrix) -> tuple[Fraction, ...] | None:
    """An unobservable direction that does not decay."""
    N = unobservable_subspace(F, C)
    if N is None:
        return None
    kept = (N.T @ N).solve(N.T @ F @ N)
    if is_hurwitz(kept):
        return None
    return _scaled(N @ _slowest(kept))


def _slowest(kept: Matrix) -> Matrix:
    """A column with a part in the eigenspace of largest real part: rounded, every column serves the proof."""
    import numpy as np

    if kept.shape[0] == 1:
        return Matrix.identity(1)
    values, vectors = np.linalg.eig(kept.floats)
    column = vectors[:, int(np.argmax(values.real))]
    real = column.real if np.linalg.norm(column.real) >= np.linalg.norm(column.imag) else column.imag
    size = float(np.abs(real).max())
    return Matrix.from_rows([[Fraction(decimal_text(float(value) / size, 9))] for value in real])


def _at_samples(F: tuple[Exact, Matrix], C: Matrix, law: SamplingLaw) -> tuple[Exact, tuple[Fraction, ...], str] | None:
    """(T, direction, growth) of pathological sampling at a constant period of the law."""
    c, F_0 = F
    spaces = list(_spaces(F_0))
    for T, q_squared in _periods([(a, w_squared) for a, w_squared, _ in spaces], c, law):
        groups: dict[tuple[Fraction, Fraction], list[Matrix]] = {}
        for a, w_squared, W in spaces:
            turns = _root(w_squared * q_squared)  # w T / pi
            if turns is not None and a >= 0:
                angle = turns % 2
                groups.setdefault((a, min(angle, 2 - angle)), []).append(W)
        for (a, angle), parts in groups.items():
            E = block([parts]) if len(parts) > 1 else parts[0]
            direction = _unseen_in(E, C, F_0, c, T, real=angle in (0, 1))
            if direction is not None:
                return T, direction, lower_text((fraction_ball(a) * c.ball() * T.ball()).exp(), 9) if a > 0 else "1"
    return None


def _at_sensors(F: tuple[Exact, Matrix], C: Matrix, law: SamplingLaw) -> tuple[Exact, tuple[Fraction, ...], str] | None:
    """(T, direction, growth) of an error that no sensor sees, of those of one a >= 0; T the shortest period."""
    c, F_0 = F
    alike: dict[Fraction, list[tuple[Fraction, Matrix]]] = {}
    for a, w_squared, W in _spaces(F_0):
        if a >= 0:
            alike.setdefault(a, []).append((w_squared, W))
    for a, spaces in alike.items():
        for chosen in (spaces, *([one] for one in spaces if len(spaces) > 1)):
            E = _beside([W for _, W in chosen])
            if E.shape[1] > _seen_of(chosen, C, c, law):
                H = law.hyperperiod
                growth = lower_text((fraction_ball(a) * c.ball() * H.ball()).exp(), 9) if a > 0 else "1"
                return law.base, _least_seen(E, C, F_0, c, law), growth
    return None


def _seen_of(spaces: list[tuple[Fraction, Matrix]], C: Matrix, c: Exact, law: SamplingLaw) -> int:
    """At most so many dimensions of the spaces' sum do the samples of all sensors see together."""
    rows, more = list[Matrix](), 0
    for sensor in law.sensors:
        own = C[list(sensor.outputs), :]
        for alike in _classes(sensor, spaces, c, law):
            parts = [own @ W if k in alike.members else own @ W * 0 for k, (_, W) in enumerate(spaces)]
            if alike.is_plain:
                rows.append(_beside(parts))
            else:
                more += int(_beside(parts).data.rank()) * (1 if alike.is_real else 2)
    return more + (int(block([[one] for one in rows]).data.rank()) if rows else 0)


class _Alike(NamedTuple):
    """Spaces (their numbers) on which exp(F T_i) turns by one angle; is_real: by 0 or pi; is_plain: and the time of the
    sensor's offset too, so that all of its samples see a multiple of what C sees."""

    members: tuple[int, ...]
    is_real: bool
    is_plain: bool


def _classes(sensor: Sensor, spaces: list[tuple[Fraction, Matrix]], c: Exact, law: SamplingLaw) -> Iterator[_Alike]:
    turned: dict[Any, list[int]] = {}
    for k, (w_squared, _) in enumerate(spaces):
        angle = _angle(w_squared, sensor.every, c, law)
        turned.setdefault(("unknown", k) if angle is None else angle, []).append(k)
    for angle, members in turned.items():
        offsets = {_angle(spaces[k][0], sensor.offset, c, law) for k in members}
        is_real = angle in (0, 1)
        yield _Alike(tuple(members), is_real, is_real and offsets in ({Fraction(0)}, {Fraction(1)}))


def _angle(w_squared: Fraction, periods: Fraction, c: Exact, law: SamplingLaw) -> Fraction | None:
    """w T / pi up to sign and whole turns, in [0, 1], for so many shortest periods; None where it is not rational."""
    if w_squared == 0 or periods == 0:
        return Fraction(0)
    squared = _turns_squared(law.base * Exact(periods) * c)
    turns = None if squared is None else _root(w_squared * squared)
    return None if turns is None else min(turns % 2, 2 - turns % 2)


def _beside(parts: list[Matrix]) -> Matrix:
    return block([parts]) if len(parts) > 1 else parts[0]


def _least_seen(E: Matrix, C: Matrix, F: Matrix, c: Exact, law: SamplingLaw) -> tuple[Fraction, ...]:
    """The direction of E that the samples of two hyperperiods see least, in floats, rounded."""
    import numpy as np

    times = [float(law.base) * float(phase.time) for phase in law.phases]
    rows = [
        C.floats[list(phase.outputs)] @ F.exp(c.ball() * arb(t + turn * float(law.hyperperiod))).floats @ E.floats
        for turn in (0, 1)
        for t, phase in zip(times, law.phases, strict=True)
    ]
    column = E.floats @ np.linalg.svd(np.vstack(rows))[2][-1]
    size = float(np.abs(column).max())
    return tuple(Fraction(round(float(value) / size, 14)).limit_denominator(10**14) for value in column)


def _spaces(F: Matrix) -> Iterator[tuple[Fraction, Fraction, Matrix]]:
    """(a, w^2, basis of W) for every rational a + i w with rational w^2: W = ker(F - a), or ker((F - a)^2 + w^2)."""
    _, factors = F.data.charpoly().factor()
    identity = Matrix.identity(F.shape[0])
    for factor, _ in factors:
        lead = factor[factor.degree()]
        if factor.degree() == 1:
            a = fmpq_fraction(-factor[0] / lead)
            W = null_space(F - identity * a)
            w_squared = Fraction(0)
        elif factor.degree() == 2:
            a = fmpq_fraction(-factor[1] / lead / 2)
            w_squared = fmpq_fraction(factor[0] / lead) - a * a
            shifted = F - identity * a
            W = null_space(shifted @ shifted + identity * w_squared)
        else:
            continue
        if W is not None and w_squared >= 0:
            yield a, w_squared, W


def _periods(
    eigenvalues: list[tuple[Fraction, Fraction]], c: Exact, law: SamplingLaw
) -> Iterator[tuple[Exact, Fraction]]:
    """(T, q^2) with c T = q pi, T in the law: the period itself, or those at which a pair is aliased."""
    if law.multiples:
        turns = ((T, _turns_squared(T * c)) for T in law.multiples)
        yield from ((T, squared) for T, squared in turns if squared is not None)
        return
    rates = [w_squared for a, w_squared in eigenvalues if a >= 0 and w_squared > 0]
    roots = [root for w_squared in rates if (root := _root(w_squared)) is not None]
    mixed = {abs(x + sign * y) / 2 for x in roots for y in roots for sign in (1, -1) if x != y}
    for w_squared in sorted({*rates, *(w * w for w in mixed)}, reverse=True):
        first = max(1, math.ceil(float(law.T_min) * math.sqrt(w_squared) * float(c) / math.pi - 1e-9))
        root = _root(w_squared)
        w = f"sqrt({w_squared})" if root is None else f"({root})"
        for k in (first, first + 1):
            T = Exact(simplify(Exact(f"{k}*pi/({w}*({c}))").expression))
            if _at_most(law.T_min, T) and _at_most(T, law.T_max):
                yield T, k * k / w_squared


def _turns_squared(angle: Exact) -> Fraction | None:
    """(angle / pi)^2 where that is rational, proved as an identity: q pi, or pi sqrt(n) / b with integers n, b."""
    q = _ratio(angle, _PI)
    if q is not None:
        return q * q
    turns = float((angle.ball() / _PI.ball()).mid())
    if not 0 < turns < 1e6:
        return None
    squared = Fraction(turns * turns).limit_denominator(_DENOMINATOR)
    b, n = Exact(squared.denominator), Exact(squared.numerator * squared.denominator)
    root = Exact(f"sqrt({n})")
    holds = is_zero((angle * b - _PI * root).expression) or is_zero((angle * b * root - _PI * n).expression)
    return squared if holds else None


def _unseen_in(E: Matrix, C: Matrix, F: Matrix, c: Exact, T: Exact, *, real: bool) -> tuple[Fraction, ...] | None:
    """A direction of E that C does not see at any sample; rounded where exp(F T) is not a multiple of I on E."""
    import numpy as np

    seen = C @ E
    rank = seen.data.rank()
    if real:
        hidden = null_space(seen)
        return None if hidden is None else _scaled(E @ hidden[:, 0])
    if E.shape[1] <= 2 * rank:
        return None
    Phi = F.exp(c.ball() * T.ball()).floats
    rows = np.vstack([seen.floats, C.floats @ Phi @ E.floats])
    column = E.floats @ np.linalg.svd(rows)[2][-1]
    size = float(np.abs(column).max())
    return tuple(Fraction(round(float(value) / size, 14)).limit_denominator(10**14) for value in column)


def _scaled(column: Matrix) -> tuple[Fraction, ...]:
    """The largest entry as 1."""
    values = [fmpq_fraction(row[0]) for row in column.tolist()]
    top = max(values, key=abs)
    return tuple(value / top for value in values)


def _root(value: Fraction) -> Fraction | None:
    """The square root of a square."""
    if value < 0:
        return None
    top, bottom = math.isqrt(value.numerator), math.isqrt(value.denominator)
    return Fraction(top, bottom) if top * top == value.numerator and bottom * bottom == value.denominator else None


def _at_most(low: Exact, high: Exact) -> bool:
    return low.is_at_most(high) or is_zero((high - low).expression)


def _short(value: Exact) -> str:
    return f"{float(value):.6g}" if value.rational is not None else str(value)


def _combination(direction: tuple[Fraction, ...], states: tuple[str, ...]) -> str:
    """2 theta - omega, as text."""
    text = ""
    for value, name in zip(direction, states, strict=True):
        if value:
            size = "" if abs(value) == 1 else f"{float(abs(value)):.6g} "
            text += (
                f"{' - ' if value < 0 else ' + '}{size}{name}" if text else f"{'-' if value < 0 else ''}{size}{name}"
            )
    return text
