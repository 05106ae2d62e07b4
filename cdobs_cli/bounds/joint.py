"""Slopes that move together: the fewest functions rho_k with Dphi = A_0 + sum_k rho_k A_k, exactly.

    phi(x_hat, u) - phi(x, u) = V e,    V = integral_0^1 Dphi(x + s e, u) ds

lies in the closed convex hull of Dphi over the (convex) domain, jointly in all entries: at one point for all of them.
Each entry is split into a sum of terms with rational coefficients; terms that always come in the same proportion are
one function, and where the entries are fewer than the functions so found, entries themselves serve.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction

from flint import fmpq, fmpq_mat

from cdobs_cli.bounds.hull import Shared, within_parallelograms
from cdobs_cli.exact.expression import ONE, ZERO, Call, Expression, ExpressionError, Number
from cdobs_cli.exact.numbers import Exact, fmpq_fraction
from cdobs_cli.exact.rational import TooLargeError, is_zero, quotients, simplify
from cdobs_cli.plant import Entry, Plant
from cdobs_cli.records import dataclass

_MOST_TERMS = 64

Terms = dict[Expression, Fraction]


@dataclass(frozen=True)
class Joint:
    """Entries = offset + sum of weights times functions."""

    functions: tuple[Shared, ...]
    offset: tuple[tuple[Entry, Exact], ...]

    def slope(self, entry: Entry) -> Expression:
        """The entry as the functions make it."""
        total = dict(self.offset).get(entry, Exact(0)).expression
        for one in self.functions:
            weight = dict(one.weights).get(entry)
            total = total if weight is None else total + Number(weight) * one.function
        return total


def joint_slopes(plant: Plant) -> Joint | None:
    """The functions behind the `auto` entries, where they are fewer than these entries or follow one another; None
    elsewhere, and where an entry cannot be taken apart."""
    derivatives = {(i, j): plant.phi[i].derivative(plant.states[j]) for i, j in sorted(plant.slopes.auto)}
    split = {}
    for entry, slope in derivatives.items():
        try:
            split[entry] = terms_of(slope)
        except (TooLargeError, ExpressionError, ZeroDivisionError, OverflowError, RecursionError):
            return None
    varying = {entry: {t: c for t, c in terms.items() if t.variables} for entry, terms in split.items()}
    varying = {entry: terms for entry, terms in varying.items() if terms}
    plain = _functions(varying)
    functions = within_parallelograms(plain, plant)
    if functions == plain and not len(plain) < len(varying):
        return None
    offset = []
    for entry in varying:
        constant = sum((Exact(c) * Exact(t) for t, c in split[entry].items() if not t.variables), Exact(0))
        offset.append((entry, constant))
    joint = Joint(tuple(functions), tuple((entry, value) for entry, value in offset if value.sign() != 0))
    return joint if all(is_zero(joint.slope(entry) - derivatives[entry]) for entry in varying) else None


def terms_of(slope: Expression) -> Terms:
    """The slope as a sum of terms with rational coefficients; ONE stands for what is constant.

    Raises: TooLargeError: more than 64 terms.
    """
    match slope:
        case Number():
            return {ONE: slope.value} if slope.value else {}
        case Call(function="add"):
            return _sum(terms_of(child) for child in slope.children)
        case Call(function="multiply"):
            left, right = (terms_of(child) for child in slope.children)
            if len(left) * len(right) > _MOST_TERMS:
                raise TooLargeError
            products = ((a * b, x * y) for a, x in left.items() for b, y in right.items())
            return _sum(_scaled(_single(term), value) for term, value in products)
        case Call(function="divide"):
            top, bottom = slope.children
            return _sum(_scaled(_single(term / bottom), value) for term, value in terms_of(top).items())
    return _single(slope)


def _single(term: Expression) -> Terms:
    """A term in canonical form, its coefficient apart; a polynomial term by term."""
    (quotient,) = quotients([term])
    ring, denominator = quotient.ring, quotient.denominator
    if quotient.numerator.is_zero():
        return {}
    pieces = [quotient.numerator]
    if denominator.is_constant():
        pieces = [ring.context.from_dict({powers: value}) for powers, value in quotient.numerator.terms()]
    terms: Terms = {}
    for piece in pieces:
        lead = piece.leading_coefficient()
        key = ring.quotient(piece / lead, denominator).expression()
        terms[key] = terms.get(key, Fraction(0)) + fmpq_fraction(lead)
    return terms


def _sum(parts: Iterable[Terms]) -> Terms:
    total: Terms = {}
    for part in parts:
        for term, value in part.items():
            total[term] = total.get(term, Fraction(0)) + value
    if len(total) > _MOST_TERMS:
        raise TooLargeError
    return {term: value for term, value in total.items() if value}


def _scaled(terms: Terms, factor: Fraction) -> Terms:
    return {term: value * factor for term, value in terms.items()}


def _functions(entries: Mapping[Entry, Terms]) -> list[Shared]:
    """The terms, those that come in one proportion put together; entries where these are fewer."""
    names = sorted({term for terms in entries.values() for term in terms}, key=str)
    groups: dict[tuple[Fraction, ...], list[tuple[Expression, Fraction]]] = {}
    for term in names:
        values = [terms.get(term, Fraction(0)) for terms in entries.values()]
        lead = next(value for value in values if value)
        groups.setdefault(tuple(value / lead for value in values), []).append((term, lead))
    functions = []
    for column, members in groups.items():
        function = _combined(members)
        weights = tuple((entry, weight) for entry, weight in zip(entries, column, strict=True) if weight)
        functions.append(Shared(simplify(function), weights))
    rows = fmpq_mat([[_fmpq(column[k]) for column in groups] for k in range(len(entries))])
    return functions if int(rows.rank()) == len(functions) else _of_entries(entries, rows)


def _of_entries(entries: Mapping[Entry, Terms], rows: fmpq_mat) -> list[Shared]:
    """Independent entries as the functions, the others combined from them."""
    reduced, rank = rows.transpose().rref()
    pivots = [next(j for j in range(reduced.ncols()) if reduced[i, j] != 0) for i in range(rank)]
    names = list(entries)
    functions = []
    for i, pivot in enumerate(pivots):
        function = _combined(entries[names[pivot]].items())
        weights = [(names[j], fmpq_fraction(reduced[i, j])) for j in range(len(names))]
        functions.append(Shared(simplify(function), tuple((entry, weight) for entry, weight in weights if weight)))
    return functions


def _combined(terms: Iterable[tuple[Expression, Fraction]]) -> Expression:
    total: Expression = ZERO
    for term, factor in terms:
        total = total + (term if factor == 1 else Number(factor) * term)
    return total


def _fmpq(value: Fraction) -> fmpq:
    return fmpq(value.numerator, value.denominator)
