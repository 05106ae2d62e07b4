"""Solving z = map(x) for x, by elimination: each unknown linear, a pure power, or inside exp, log or a root."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from fractions import Fraction

from cdobs_cli.exact.expression import ZERO, Call, Expression, ExpressionError, Number, Power, Variable, call, power
from cdobs_cli.exact.language import LANGUAGE
from cdobs_cli.exact.parser import MAX_EXPONENT
from cdobs_cli.exact.rational import TooLargeError, quotients, simplify

Trees = Sequence[Expression]
Names = Sequence[str]
# f(x) = v gives x = g(v), where g undoes f.
_INVERSES = {function.undoes: name for name, function in LANGUAGE.items() if function.undoes}


def solve(equations: Trees, unknowns: Names, nonnegative: Collection[str] = ()) -> dict[str, Expression] | None:
    """x from `equation = 0` for each equation; None where elimination does not find it.

    Args:
        equations: as many as unknowns; other variables are parameters of the solution.
        nonnegative: unknowns that are >= 0, of which an even power may be undone.
    """
    left = list(equations)
    open_unknowns = list(unknowns)
    steps: list[tuple[str, Expression]] = []
    while open_unknowns:
        found = _easiest(left, open_unknowns, nonnegative)
        if found is None:
            return None
        k, name, value = found
        steps.append((name, value))
        open_unknowns.remove(name)
        left = [simplify(equation.substitute({name: value})) for i, equation in enumerate(left) if i != k]
    solution: dict[str, Expression] = {}
    for name, value in reversed(steps):
        solution[name] = simplify(value.substitute(solution))
    return solution


def _easiest(equations: Trees, unknowns: Names, nonnegative: Collection[str]) -> tuple[int, str, Expression] | None:
    """An equation with as few unknowns as possible, and one of them solved for."""
    wanted = set(unknowns)
    order = sorted(range(len(equations)), key=lambda k: (len(equations[k].variables & wanted), equations[k].size))
    pairs = ((k, name) for k in order for name in unknowns if name in equations[k].variables)
    found = ((k, name, _isolated(equations[k], name, nonnegative)) for k, name in pairs)
    return next(((k, name, value) for k, name, value in found if value is not None), None)


def _isolated(equation: Expression, name: str, nonnegative: Collection[str]) -> Expression | None:
    """The variable from equation = 0."""
    try:
        top = quotients([equation])[0]
    except (TooLargeError, ZeroDivisionError, ExpressionError):
        return None
    holders = [
        (index, generator) for index, generator in enumerate(top.ring.generators)
        if name in generator.variables and top.numerator.degrees()[index] > 0
    ]  # fmt: skip
    if len(holders) != 1:
        return None
    index, generator = holders[0]
    parts = top.ring.collected(top.numerator, index)
    degrees = sorted(degree for degree in parts if degree > 0)
    if len(degrees) != 1:
        return None
    value = simplify(-parts.get(0, ZERO) / parts[degrees[0]])
    if degrees[0] > 1:
        is_positive = generator == Variable(name) and name in nonnegative
        if degrees[0] % 2 == 0 and not is_positive and not isinstance(generator, Power):
            return None
        if isinstance(generator, Power):
            # The generator is a root of the variable: (v^(1/q))^k = v^(k/q).
            return _power(value, 1 / (generator.exponent * degrees[0])) if generator.base == Variable(name) else None
        value = power(value, Fraction(1, degrees[0]))
    if generator == Variable(name):
        return value
    return _undone(generator, value, name, nonnegative)


def _power(value: Expression, exponent: Fraction) -> Expression | None:
    """value ** exponent, where a spec could type it."""
    return power(value, exponent) if abs(exponent) <= MAX_EXPONENT else None


def _undone(generator: Expression, value: Expression, name: str, nonnegative: Collection[str]) -> Expression | None:
    """The variable from generator = value."""
    match generator:
        case Power():
            undone = _power(value, 1 / generator.exponent)
        case Call() if generator.function in _INVERSES:
            undone = call(_INVERSES[generator.function], value)
        case _:
            return None
    (inner,) = generator.children
    return undone if undone is None or inner == Variable(name) else _isolated(inner - undone, name, nonnegative)


def substituted(expressions: Sequence[Expression], values: Mapping[str, Expression]) -> tuple[Expression, ...]:
    """The expressions with variables replaced, cancelled."""
    return tuple(simplify(expression.substitute(values)) for expression in expressions)


def determinant(rows: Sequence[Sequence[Expression]]) -> Expression:
    """The determinant by expansion along the first row, zeros skipped."""
    if len(rows) == 1:
        return rows[0][0]
    held = [(j, entry) for j, entry in enumerate(rows[0]) if entry != ZERO]
    minors = (determinant([[*row[:j], *row[j + 1 :]] for row in rows[1:]]) for j, _ in held)
    return sum((Number((-1) ** j) * entry * minor for (j, entry), minor in zip(held, minors, strict=True)), ZERO)
