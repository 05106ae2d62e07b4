"""f(x, u) = A x + phi(x, u) + B u: what is linear with constant coefficients goes to A, what is left to phi."""

from __future__ import annotations

from collections.abc import Sequence

from cdobs_cli.bounds.differ import compared
from cdobs_cli.coordinates.typed import typed_region
from cdobs_cli.errors import Problem, SpecError
from cdobs_cli.exact.expression import ZERO, Expression, Variable
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.rational import simplify
from cdobs_cli.plant import Plant, Slopes, TypedDynamics


def linear_terms(A: ExactMatrix, typed: TypedDynamics, names: Sequence[str]) -> list[Expression]:
    """A z + B u."""
    rows = []
    for i in range(len(names)):
        total: Expression = ZERO
        for j, name in enumerate(names):
            total = total + A[i, j].expression * Variable(name)
        for j, source in enumerate(typed.inputs if typed.B is not None else ()):
            assert typed.B is not None
            total = total + typed.B[i, j].expression * Variable(source.name)
        rows.append(total)
    return rows


def as_printed(phi: Sequence[Expression], printed: Sequence[Expression] | None) -> tuple[Expression, ...]:
    """Each component as the user printed it, where that is the same function."""
    from cdobs_cli.exact.rational import is_zero

    if printed is None:
        return tuple(phi)
    return tuple(theirs if is_zero(own - theirs) else own for own, theirs in zip(phi, printed, strict=True))


def automatic_slopes(phi: Sequence[Expression], names: Sequence[str]) -> Slopes:
    """`auto` for every slope that is not identically 0."""
    n = len(names)
    zero = ExactMatrix([[0] * n] * n)
    entries = ((i, j) for i in range(n) for j, name in enumerate(names) if simplify(phi[i].derivative(name)) != ZERO)
    return Slopes(zero, zero, frozenset(entries))


def _terms(expression: Expression) -> list[Expression]:
    """The terms of a sum."""
    from cdobs_cli.exact.expression import MINUS_ONE, Call

    if isinstance(expression, Call) and expression.function == "add":
        return [term for child in expression.children for term in _terms(child)]
    if isinstance(expression, Call) and expression.function == "multiply" and expression.children[0] == MINUS_ONE:
        return [-term for term in _terms(expression.children[1])]
    return [expression]


def linear_part(f: Sequence[Expression], names: Sequence[str], *, cancel: bool = True) -> tuple[ExactMatrix, tuple[Expression, ...]]:
    """A and the rest: f = A x + phi, where A takes the terms `constant * state` of each sum as it is typed."""
    rows, rest = [], []
    for one in f:
        row: list[Expression] = [ZERO] * len(names)
        left: Expression = ZERO
        for term in _terms(simplify(one) if cancel else one):
            slopes = [simplify(term.derivative(name)) for name in names]
            linear = _is_plain(term) and not any(slope.variables for slope in slopes)
            if linear and simplify(term.substitute(dict.fromkeys(names, ZERO))) == ZERO:
                row = [simplify(entry + slope) for entry, slope in zip(row, slopes, strict=True)]
            else:
                left = left + term
        rows.append([Exact(entry) for entry in row])
        rest.append(left)
    return ExactMatrix(rows), tuple(rest)


def _is_plain(term: Expression) -> bool:
    """A product of constants and variables: nothing that could be undefined somewhere."""
    from cdobs_cli.exact.expression import Call

    for node in term.walk():
        if node.variables and isinstance(node, Call):
            if node.function not in ("multiply", "add", "divide"):
                return False
            if node.function == "divide" and node.children[1].variables:
                return False
    return True


def linear_output(outputs: Sequence[Expression], names: Sequence[str]) -> ExactMatrix:
    rows = []
    for k, one in enumerate(outputs):
        slopes = [simplify(one.derivative(name)) for name in names]
        offset = simplify(one.substitute(dict.fromkeys(names, ZERO))) if not any(slope.variables for slope in slopes) else None
        if offset != ZERO:
            what = "an output is linear in the states"
            raise SpecError((Problem(("plant", "output", k), what, str(one), hint="use `coordinates` to make it one of them"),))
        rows.append([Exact(slope) for slope in slopes])
    return ExactMatrix(rows)


def split(typed: TypedDynamics) -> Plant:
    """xdot = f(x, u) as A x + phi + B u in the typed states: linear terms with constant coefficients go to A.

    Raises: SpecError: an output that is not linear; a printed plant that is not this one.
    """
    n = len(typed.states)
    C = linear_output(tuple(simplify(one) for one in typed.output), typed.states)
    if typed.C is not None and typed.C != C:
        raise SpecError((Problem(("measurement", "C"), "is not that of `output`", str(typed.C.texts()), str(C.texts())),))
    if typed.A is None:
        A, phi = linear_part(typed.dynamics, typed.states, cancel=False)
        if typed.B is not None:
            inputs = linear_terms(ExactMatrix([[0] * n] * n), typed, typed.states)
            phi = tuple(simplify(one - part) for one, part in zip(phi, inputs, strict=True))
    else:
        A = typed.A
        phi = tuple(simplify(f - part) for f, part in zip(typed.dynamics, linear_terms(A, typed, typed.states), strict=True))
    region = typed_region(typed)
    for i, printed in enumerate(typed.phi or ()):
        found = compared(printed, phi[i], region)
        if found.status == "refuted":
            raise SpecError((Problem(("plant", "phi", i), "is not what `dynamics` leaves beside A x + B u", str(printed), str(phi[i])),))
    return Plant(
        typed.states, typed.inputs, A, as_printed(phi, typed.phi), typed.B, C, typed.slopes or automatic_slopes(phi, typed.states),
        typed.sampling, typed.domain, typed.disturbance, typed.noise,
    )  # fmt: skip
