"""A function of (x; x_hat, u) as sum_k a_k(x) m_k(x_hat, u), and the bound of its modulus that this gives."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import reduce

from cdobs_cli.exact.expression import ONE, ZERO, Call, Expression, Number, Power, call, power
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.exact.rational import simplify

MAX_TERMS = 24
Terms = dict[Expression, Expression]
"""m_k -> a_k."""


def separated(expression: Expression, known: frozenset[str]) -> Terms | None:
    """The sum with m_k over the names `known`, a_k over the others; None where the tree does not come apart."""
    inside = expression.variables
    if inside <= known:
        return {expression: ONE}
    if not inside & known:
        return {ONE: expression}
    if isinstance(expression, Power):
        return _power(expression, known)
    if not isinstance(expression, Call) or expression.function not in ("add", "multiply", "divide"):
        return None
    left, right = (separated(child, known) for child in expression.children)
    if left is None or right is None:
        return None
    if expression.function == "add":
        return _collected((*left.items(), *right.items()))
    if expression.function == "multiply":
        return _product(left, right)
    if len(right) != 1:
        return None
    ((m_right, a_right),) = right.items()
    return {simplify(m / m_right): a / a_right for m, a in left.items()}


def _collected(terms: Iterable[tuple[Expression, Expression]]) -> Terms | None:
    total: Terms = {}
    for m, a in terms:
        total[m] = total.get(m, ZERO) + a
    return total if len(total) <= MAX_TERMS else None


def _product(left: Terms | None, right: Terms) -> Terms | None:
    if left is None or len(left) * len(right) > MAX_TERMS:
        return None
    return _collected((simplify(m * n), a * b) for m, a in left.items() for n, b in right.items())


def _power(expression: Power, known: frozenset[str]) -> Terms | None:
    base, exponent = separated(expression.base, known), expression.exponent
    if base is None or exponent.denominator != 1:
        return None
    if len(base) == 1:
        ((m, a),) = base.items()
        return {power(m, exponent): power(a, exponent)}
    start: Terms | None = {ONE: ONE}
    return reduce(_product, [base] * int(exponent), start) if 0 < exponent <= 4 else None


def modulus_bound(terms: Terms, ends: Callable[[Expression], tuple[Exact, Exact] | None]) -> Expression | None:
    """|sum a_k m_k| <= |sum mid(a_k) m_k| + sum rad(a_k) |m_k|, an expression of (x_hat, u).

    `ends` gives proved ends of each a_k. Exact where only one a_k varies.
    """
    middle: Expression = ZERO
    spread: Expression = ZERO
    for m, a in terms.items():
        low, high = (end.rational for end in found) if (found := ends(simplify(a))) else (None, None)
        if low is None or high is None:
            return None
        middle = middle + Number((low + high) / 2) * m
        spread = spread + Number((high - low) / 2) * call("abs", m)
    return (ZERO if middle == ZERO else call("abs", simplify(middle))) + spread
