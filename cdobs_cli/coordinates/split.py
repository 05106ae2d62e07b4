"""f(x, u) = A x + phi(x, u) + B u: what is linear with constant coefficients goes to A, what is left to phi."""

from __future__ import annotations

from collections.abc import Sequence

from cdobs_cli.bounds.differ import compared
from cdobs_cli.bounds.region import Region
from cdobs_cli.errors import Problem, SpecError
from cdobs_cli.exact.expression import ZERO, Call, Expression, Variable, terms
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.rational import is_zero, simplify
from cdobs_cli.plant import Plant, Slopes, TypedDynamics
from cdobs_cli.records import dataclass

Trees = Sequence[Expression]


def linear_terms(A: ExactMatrix | None, typed: TypedDynamics, names: Sequence[str]) -> list[Expression]:
    """A z + B u, or B u alone."""
    inputs = tuple(source.name for source in typed.inputs)
    parts = [(matrix, columns) for matrix, columns in ((A, names), (typed.B, inputs)) if matrix is not None]
    return [
        sum((M[i, j].expression * Variable(name) for M, columns in parts for j, name in enumerate(columns)), ZERO)
        for i in range(len(names))
    ]  # fmt: skip


def as_printed(phi: Sequence[Expression], printed: Sequence[Expression] | None) -> tuple[Expression, ...]:
    """Each component as the user printed it, where that is the same function."""
    if printed is None:
        return tuple(phi)
    return tuple(theirs if is_zero(own - theirs) else own for own, theirs in zip(phi, printed, strict=True))


def automatic_slopes(phi: Sequence[Expression], names: Sequence[str]) -> Slopes:
    """`auto` for every slope that is not identically 0."""
    zero = ExactMatrix([[0] * len(names)] * len(names))
    slopes = (((i, j), one.derivative(name)) for i, one in enumerate(phi) for j, name in enumerate(names))
    return Slopes(zero, zero, frozenset(at for at, slope in slopes if simplify(slope) != ZERO))


def linear_part(f: Trees, names: Sequence[str], *, cancel: bool = True) -> tuple[ExactMatrix, tuple[Expression, ...]]:
    """A and the rest: f = A x + phi, where A takes the terms `constant * state` of each sum as it is typed."""
    rows, rest = [], []
    for one in f:
        row: list[Expression] = [ZERO] * len(names)
        left: Expression = ZERO
        for term in terms(simplify(one) if cancel else one):
            slopes = _slopes(term, names) if _is_plain(term) else None
            if slopes is not None and simplify(term.substitute(dict.fromkeys(names, ZERO))) == ZERO:
                row = [simplify(entry + slope) for entry, slope in zip(row, slopes, strict=True)]
            else:
                left = left + term
        rows.append([Exact(entry) for entry in row])
        rest.append(left)
    return ExactMatrix(rows), tuple(rest)


def _slopes(one: Expression, names: Sequence[str]) -> list[Expression] | None:
    """Its slopes, where all are constant."""
    slopes = [simplify(one.derivative(name)) for name in names]
    return None if any(slope.variables for slope in slopes) else slopes


def _is_plain(term: Expression) -> bool:
    """A product of constants and variables: nothing that could be undefined somewhere."""
    calls = [node for node in term.walk() if node.variables and isinstance(node, Call)]
    return all(
        node.function in ("multiply", "add") or (node.function == "divide" and not node.children[1].variables)
        for node in calls
    )  # fmt: skip


def linear_output(outputs: Sequence[Expression], names: Sequence[str]) -> ExactMatrix:
    """C, where every output is C z in the coordinates."""
    rows = []
    for k, one in enumerate(outputs):
        slopes = _slopes(one, names)
        if slopes is None or not _is_zero_at_rest(one, names):
            what, hint = "an output is linear in the coordinates", "make it one of them, or leave `coordinates` out"
            raise SpecError((Problem(("plant", "output", k), what, str(one), hint=hint),))
        rows.append([Exact(slope) for slope in slopes])
    return ExactMatrix(rows)


def _is_zero_at_rest(one: Expression, names: Sequence[str]) -> bool:
    return simplify(one.substitute(dict.fromkeys(names, ZERO))) == ZERO


@dataclass(frozen=True)
class Measured:
    """y = h(x, u): C holds the slopes that are constant, H those to be found; both None where y = C x."""

    C: ExactMatrix
    h: tuple[Expression, ...] | None
    H: Slopes | None


def measured(outputs: Sequence[Expression], names: Sequence[str]) -> Measured:
    """Outputs as typed, the slopes that are not constant left `auto`."""
    slopes = [[simplify(one.derivative(name)) for name in names] for one in outputs]
    constant = [[ZERO if slope.variables else slope for slope in row] for row in slopes]
    C = ExactMatrix([[Exact(slope) for slope in row] for row in constant])
    places = ((k, j) for k, row in enumerate(slopes) for j, slope in enumerate(row) if slope.variables)
    auto = frozenset(places)
    if auto:
        return Measured(C, tuple(outputs), Slopes(C, C, auto))
    return Measured(C, None if all(_is_zero_at_rest(one, names) for one in outputs) else tuple(outputs), None)


def split(typed: TypedDynamics) -> Plant:
    """xdot = f(x, u) as A x + phi + B u in the typed states: linear terms with constant coefficients go to A.

    Raises: SpecError: a printed plant that is not this one.
    """
    seen = measured(typed.output, typed.states)
    if typed.C is not None and (typed.C != seen.C or seen.H is not None):
        got, allowed = str(typed.C.texts()), str(seen.C.texts()) if seen.H is None else "nothing: it is not linear"
        raise SpecError((Problem(("measurement", "C"), "is not that of `output`", got, allowed),))
    A, phi = (typed.A, typed.dynamics) if typed.A else linear_part(typed.dynamics, typed.states, cancel=False)
    if typed.A is not None or typed.B is not None:
        known = linear_terms(typed.A, typed, typed.states)
        phi = tuple(simplify(one - part) for one, part in zip(phi, known, strict=True))
    region = Region.of(typed)
    for i, printed in enumerate(typed.phi or ()):
        if compared(printed, phi[i], region).status == "refuted":
            what = "is not what `dynamics` leaves beside A x + B u"
            raise SpecError((Problem(("plant", "phi", i), what, str(printed), str(phi[i])),))
    slopes = typed.slopes or automatic_slopes(phi, typed.states)
    return Plant(
        typed.states, typed.inputs, A, as_printed(phi, typed.phi), typed.B, seen.C, slopes, typed.sampling,
        typed.domain, typed.disturbance, typed.noise, typed.intensity, typed.covariance, seen.h, seen.H,
        typed.delays,
    )  # fmt: skip
