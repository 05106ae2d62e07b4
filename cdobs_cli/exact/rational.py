"""Expressions as quotients of polynomials with rational coefficients, cancelled exactly.

The generators are the variables and every part that is not rational (`sin(..)`, `sqrt(..)`, `pi`, ..), each
with its own argument brought to this form first. Cancelling may enlarge the set where a value is defined
(x/x becomes 1), so definedness is judged elsewhere, on the typed tree.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import lru_cache, reduce
from math import comb, floor, inf, lcm
from typing import Any

from flint import Ordering, fmpq, fmpq_mpoly_ctx

from cdobs_cli.exact.budget import forgotten, spend
from cdobs_cli.exact.expression import (
    MAX_ROOT,
    ZERO,
    Call,
    Constant,
    Expression,
    ExpressionError,
    Number,
    Power,
    Variable,
    call,
    multiply,
    negated,
    power,
    terms,
)
from cdobs_cli.exact.language import LANGUAGE
from cdobs_cli.exact.numbers import fmpq_fraction
from cdobs_cli.records import dataclass

MAX_TERMS = 600
MAX_DEGREE = 64
_ARITHMETIC = ("add", "multiply", "divide")
_FACTORED_TERMS = 80
_FACTORED_WORK = 300_000


class TooLargeError(ValueError):
    """The polynomials grew beyond use."""


_NO_FORM = (TooLargeError, ZeroDivisionError, ExpressionError, OverflowError, RecursionError)


@dataclass(frozen=True)
class Quotient:
    """numerator / denominator, without a common factor, in one ring of polynomials."""

    ring: Ring
    numerator: Any
    denominator: Any

    def expression(self) -> Expression:
        """Back to a tree: factored, integer coefficients inside, signs outside."""
        (coefficient, top), (divisor, bottom) = map(self.ring.factors, (self.numerator, self.denominator))
        coefficient /= divisor
        below = ((base, -exponent) for base, exponent in map(_split, bottom))
        parts = _joined([*map(_split, top), *below])
        factors = [power(base, exponent) for base, exponent in parts if exponent > 0]
        if coefficient < 0:
            # a - b rather than -(b - a).
            sums = (k for k, one in enumerate(factors) if len(terms(one)) > 1 and any(map(_is_minus, terms(one))))
            k = next(sums, None)
            if k is not None:
                factors[k], coefficient = _turned(factors[k]), -coefficient
        value = _product(factors, Number(abs(coefficient.numerator)))
        divisors = (power(base, -exponent) for base, exponent in parts if exponent < 0)
        value = value / _product(divisors, Number(coefficient.denominator))
        return -value if coefficient < 0 else value


def _split(factor: Expression) -> tuple[Expression, Fraction]:
    """Base and exponent."""
    return (factor.base, factor.exponent) if isinstance(factor, Power) else (factor, Fraction(1))


def _joined(factors: Iterable[tuple[Expression, Fraction]]) -> list[tuple[Expression, Fraction]]:
    """A product with the powers of each base put together."""
    exponents: dict[Expression, Fraction] = {}
    for base, exponent in factors:
        exponents[base] = exponents.get(base, Fraction(0)) + exponent
    return list(exponents.items())


def _product(factors: Iterable[Expression], start: Expression) -> Expression:
    return reduce(multiply, factors, start)


def _is_minus(term: Expression) -> bool:
    return negated(term) is not None


def _turned(total: Expression) -> Expression:
    """-(a - b) as b - a, term by term, what stays positive first."""
    turned = [negated(term) or -term for term in terms(total)]
    return sum(sorted(turned, key=_is_minus), ZERO)


class Ring:
    """Polynomials over the rationals in the given generators."""

    def __init__(self, generators: Sequence[Expression]) -> None:
        self.generators = tuple(generators)
        names = tuple(f"g{k}" for k in range(len(self.generators))) or ("g0",)
        self.context = fmpq_mpoly_ctx.get(names, Ordering.degrevlex)
        self.gens = self.context.gens()

    def constant(self, value: Fraction) -> Any:
        return self.context.constant(fmpq(value.numerator, value.denominator))

    def quotient(self, top: Any, bottom: Any) -> Quotient:
        """Cancelled.

        Raises: ZeroDivisionError, TooLargeError.
        """
        spend(3)
        if bottom.is_zero():
            raise ZeroDivisionError("division by an expression that is identically zero")
        if max(len(top), len(bottom)) > MAX_TERMS or max((*top.degrees(), *bottom.degrees()), default=0) > MAX_DEGREE:
            raise TooLargeError
        if top.is_zero():
            return Quotient(self, top, self.constant(Fraction(1)))
        spend(_division_work(top, bottom))
        common = top.gcd(bottom)
        if not common.is_constant():
            top, bottom = top / common, bottom / common
        lead = bottom.leading_coefficient()
        return Quotient(self, top / lead, bottom / lead)

    def add(self, a: Quotient, b: Quotient) -> Quotient:
        if a.denominator == b.denominator:
            spend(len(a.numerator) + len(b.numerator))
            return self.quotient(a.numerator + b.numerator, a.denominator)
        spend(_product_work(a, b))
        return self.quotient(a.numerator * b.denominator + b.numerator * a.denominator, a.denominator * b.denominator)

    def multiply(self, a: Quotient, b: Quotient) -> Quotient:
        spend(_product_work(a, b))
        return self.quotient(a.numerator * b.numerator, a.denominator * b.denominator)

    def divide(self, a: Quotient, b: Quotient) -> Quotient:
        spend(_product_work(a, b))
        return self.quotient(a.numerator * b.denominator, a.denominator * b.numerator)

    def power(self, a: Quotient, exponent: Fraction) -> Quotient:
        size = abs(exponent.numerator)
        parts = (a.numerator, a.denominator)
        count = max(comb(len(part) + size - 1, size) for part in parts if len(part)) if len(a.numerator) else 1
        if count > 4 * MAX_TERMS or max((d for part in parts for d in part.degrees()), default=0) * size > MAX_DEGREE:
            raise TooLargeError
        spend(count * size)
        top, bottom = a.numerator**size, a.denominator**size
        return self.quotient(top, bottom) if exponent > 0 else self.quotient(bottom, top)

    def factors(self, polynomial: Any) -> tuple[Fraction, list[Expression]]:
        """A coefficient, and factors whose leading coefficients are positive."""
        if polynomial.is_zero():
            return Fraction(0), []
        work = _factoring_work(polynomial) if len(polynomial) <= _FACTORED_TERMS else inf
        spend(len(polynomial))
        if work <= _FACTORED_WORK:
            spend(int(work))
            content, parts = polynomial.factor()
        else:
            content, parts = fmpq(1), [(polynomial, 1)]
        coefficient = fmpq_fraction(content)
        factors = []
        for part, multiplicity in parts:
            side = 1 if part.leading_coefficient() > 0 else -1
            coefficient *= side ** int(multiplicity)
            factors.append(_raised(self._sum(part * side), int(multiplicity)))
        return coefficient, factors

    def collected(self, polynomial: Any, index: int) -> dict[int, Expression]:
        """Coefficients by powers of one generator."""
        parts: dict[int, Any] = {}
        for powers, value in polynomial.terms():
            rest = tuple(0 if k == index else exponent for k, exponent in enumerate(powers))
            term = self.context.from_dict({rest: value})
            degree = int(powers[index])
            parts[degree] = parts[degree] + term if degree in parts else term
        return {degree: self._sum(part) for degree, part in parts.items()}

    def _sum(self, polynomial: Any) -> Expression:
        signed: tuple[list[Expression], list[Expression]] = [], []
        for powers, value in polynomial.terms():
            coefficient = fmpq_fraction(value)
            held = [(_split(one), int(count)) for one, count in zip(self.generators, powers, strict=False) if count]
            factors = _joined((base, inner * count) for (base, inner), count in held)
            term = _product((power(*factor) for factor in factors), Number(abs(coefficient)))
            signed[coefficient < 0].append(term)
        positive, negative = signed
        return sum((-term for term in negative), sum(positive, ZERO))


def _bits(polynomial: Any) -> int:
    """Size of the largest coefficient, with what brings all to one denominator."""
    values = [(int(value.p), int(value.q)) for value in polynomial.coeffs()]
    return max((abs(p).bit_length() for p, _ in values), default=0) + lcm(*(q for _, q in values)).bit_length()


def _product_work(a: Quotient, b: Quotient) -> int:
    sizes = [len(part) for part in (a.numerator, a.denominator, b.numerator, b.denominator)]
    return (sizes[0] + sizes[1]) * (sizes[2] + sizes[3]) // 2


def _division_work(top: Any, bottom: Any) -> int:
    """What a greatest common divisor may cost; coefficients are looked at where there are many."""
    count = len(top) + len(bottom)
    return count * (4 if count < 20 else 4 + max(_bits(top), _bits(bottom)) // 4)


def _factoring_work(polynomial: Any) -> int:
    """What factors may cost: high degrees in many variables are slow."""
    if len(polynomial) < 2:
        return 1
    return 20 * len(polynomial) * int(sum(polynomial.degrees())) * (1 + _bits(polynomial) // 64)


def _raised(generator: Expression, exponent: int) -> Expression:
    base, inner = _split(generator)
    return power(base, inner * exponent)


def quotients(expressions: Sequence[Expression]) -> list[Quotient]:
    """The canonical forms of several expressions in one ring.

    Raises: TooLargeError, ZeroDivisionError (a denominator that is identically zero).
    """
    prepared = _prepared(expressions)
    generators = _generators(prepared)
    ring = Ring(tuple(generators))
    memo: dict[Expression, Quotient] = {}
    one = ring.constant(Fraction(1))
    for k, (generator, degree) in enumerate(generators.items()):
        memo[generator] = Quotient(ring, ring.gens[k], one)
        # With a root r of a variable about, r is the generator: v = r^q, v^(1/d) = r^(q/d).
        for part in (divisor for divisor in range(1, degree) if degree % divisor == 0):
            root = power(generator.children[0], Fraction(1, part))
            memo[root] = Quotient(ring, ring.gens[k] ** (degree // part), one)
    arithmetic = {"add": ring.add, "multiply": ring.multiply, "divide": ring.divide}

    def leaf(node: Expression) -> Quotient:
        assert isinstance(node, Number)
        return Quotient(ring, ring.constant(node.value), one)

    return [expression.read(leaf, ring.power, arithmetic, memo) for expression in prepared]


def _prepared(expressions: Sequence[Expression]) -> list[Expression]:
    """Trees of + * / and integer powers over generators, whose arguments are in canonical form."""
    memo: dict[Expression, Expression] = {}
    for expression in expressions:
        for node in expression.walk(memo):
            spend(3)
            if isinstance(node, Power):
                memo[node] = _prepared_power(memo[node.base], node.exponent)
            elif isinstance(node, Call) and node.function == "sqrt":
                memo[node] = Power(simplify(memo[node.children[0]]), Fraction(1, 2))
            elif isinstance(node, Call) and node.function not in _ARITHMETIC:
                memo[node] = _undone(call(node.function, *(simplify(memo[child]) for child in node.children)))
            else:
                memo[node] = node.over(memo)
    return [memo[expression] for expression in expressions]


def _prepared_power(base: Expression, exponent: Fraction) -> Expression:
    """A power of a root r of the base; what is no root is a generator itself, once whole powers are taken out."""
    if exponent.denominator == 1:
        return power(base, exponent)
    if exponent.denominator <= MAX_ROOT:
        return power(Power(simplify(base), Fraction(1, exponent.denominator)), Fraction(exponent.numerator))
    whole = Fraction(floor(exponent))
    return power(base, whole) * Power(simplify(base), exponent - whole)


def _undone(node: Expression) -> Expression:
    """f(g(x)) as x where f undoes g."""
    if isinstance(node, Call) and node.function in LANGUAGE and LANGUAGE[node.function].undoes:
        (inner,) = node.children
        if isinstance(inner, Call) and inner.function == LANGUAGE[node.function].undoes:
            return inner.children[0]
    return node


def _is_generator(node: Expression) -> bool:
    """Whatever is not built by + * / and integer powers."""
    if isinstance(node, Power):
        return node.exponent.denominator > 1
    return not isinstance(node, Number) and not (isinstance(node, Call) and node.function in _ARITHMETIC)


def _generators(expressions: Sequence[Expression]) -> dict[Expression, int]:
    """The generators of trees prepared by `_prepared`: each with d where it is v^(1/d), for all roots of v; else 1."""
    used: dict[Expression, None] = {}
    seen: set[Expression] = set()
    stack = list(expressions)
    while stack:
        node = stack.pop()
        if node in seen:
            continue
        seen.add(node)
        if _is_generator(node):
            used[node] = None
        else:
            stack.extend(node.children)
    powers = [node for node in used if isinstance(node, Power) and isinstance(node.base, Variable)]
    roots = [node for node in powers if node.exponent.denominator <= MAX_ROOT]
    degrees: dict[Expression, int] = {}
    for node in roots:
        degrees[node.base] = lcm(degrees.get(node.base, 1), node.exponent.denominator)
    found = dict.fromkeys(used.keys() - degrees.keys() - set(roots), 1)
    found |= {Power(base, Fraction(1, degree)): degree for base, degree in degrees.items()}
    return dict(sorted(found.items(), key=lambda one: (not isinstance(one[0], Variable), str(one[0]))))


@lru_cache(maxsize=4096)  # arguments of nested functions come back at every level
def simplify(expression: Expression) -> Expression:
    """The same function where it is defined, cancelled and factored; unchanged where it grows too large.

    Raises: WorkError: the budget of the task is used up.
    """
    if isinstance(expression, Number | Constant | Variable):
        return expression
    try:
        return quotients([expression])[0].expression()
    except _NO_FORM:
        return expression


forgotten(simplify.cache_clear)


def is_zero(expression: Expression) -> bool:
    """Whether the canonical form is 0: an identity in the generators (sufficient, not necessary)."""
    try:
        return bool(quotients([expression])[0].numerator.is_zero())
    except _NO_FORM:
        return False
