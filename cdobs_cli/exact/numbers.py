"""Exact numbers and matrices of them: the only owner of what the user typed and what the tool printed.

Floats and balls are views. Text made from a bound is always rounded to the stated, safe side.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any

from cdobs_cli.exact.expression import Expression, ExpressionError, Number
from cdobs_cli.exact.expression import fraction_text as fraction_text
from cdobs_cli.exact.expression import plain_decimal as plain_decimal
from cdobs_cli.exact.parser import parse

if TYPE_CHECKING:
    import numpy as np
    from flint import arb, fmpq
    from numpy.typing import NDArray

    from cdobs_cli.exact.matrix import Matrix


class Exact:
    """A real number held exactly: a rational, or a closed expression in pi, e and the functions.

    Raises:
        ExpressionError: the text is not a constant expression.
    """

    def __init__(self, value: str | int | Fraction | Expression) -> None:
        if isinstance(value, str):
            value = parse(value)
        self.expression = value if isinstance(value, Expression) else Number(value)
        if self.expression.variables:
            raise ExpressionError("a number is expected, not an expression of variables")

    @property
    def rational(self) -> Fraction | None:
        """The value, where it is rational by construction."""
        return self.expression.value if isinstance(self.expression, Number) else None

    def ball(self) -> arb:
        """Enclosure at the working precision of flint."""
        return self.expression.ball({})

    @property
    def scalar(self) -> fmpq | arb:
        """As flint computes with it: a rational where the number is one, else its ball."""
        from flint import fmpq

        rational = self.rational
        return self.ball() if rational is None else fmpq(rational.numerator, rational.denominator)

    def __float__(self) -> float:
        return float(self.expression.value) if isinstance(self.expression, Number) else float(self.ball().mid())

    def sign(self) -> int | None:
        """-1, 0 or 1; None where balls cannot tell."""
        rational = self.rational
        if rational is not None:
            return (rational > 0) - (rational < 0)
        ball = self.ball()
        return 1 if ball > 0 else -1 if ball < 0 else 0 if ball.is_zero() else None

    def __neg__(self) -> Exact:
        return Exact(-self.expression)

    def __add__(self, other: Exact) -> Exact:
        return Exact(self.expression + other.expression)

    def __sub__(self, other: Exact) -> Exact:
        return Exact(self.expression - other.expression)

    def __mul__(self, other: Exact) -> Exact:
        return Exact(self.expression * other.expression)

    def is_at_most(self, other: Exact) -> bool:
        """Whether self <= other for certain."""
        mine, theirs = self.rational, other.rational
        if mine is not None and theirs is not None:
            return mine <= theirs
        return self == other or (other - self).sign() in (0, 1)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Exact) and self.expression == other.expression

    def __hash__(self) -> int:
        return hash(self.expression)

    def __str__(self) -> str:
        rational = self.rational
        return str(self.expression) if rational is None else fraction_text(rational)

    def __repr__(self) -> str:
        return f"Exact({str(self)!r})"


EXACT_ZERO = Exact(0)


class ExactMatrix:
    """A matrix of exact numbers, shape (rows, columns)."""

    def __init__(self, rows: Iterable[Iterable[Exact | str | int | Fraction]]) -> None:
        self.rows: tuple[tuple[Exact, ...], ...] = tuple(
            tuple(entry if isinstance(entry, Exact) else Exact(entry) for entry in row) for row in rows
        )
        if not self.rows or any(len(row) != len(self.rows[0]) for row in self.rows):
            raise ValueError("a matrix has rows of one length")

    @staticmethod
    def diagonal(entries: Sequence[Exact]) -> ExactMatrix:
        return ExactMatrix([[one if i == j else 0 for j in range(len(entries))] for i, one in enumerate(entries)])

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.rows), len(self.rows[0])

    def __getitem__(self, index: tuple[int, int]) -> Exact:
        return self.rows[index[0]][index[1]]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ExactMatrix) and self.rows == other.rows

    def __hash__(self) -> int:
        return hash(self.rows)

    def __repr__(self) -> str:
        return f"ExactMatrix({self.texts()})"

    @cached_property
    def floats(self) -> NDArray[np.float64]:
        """Nearest floats, read-only."""
        import numpy as np

        array = np.array([[float(entry) for entry in row] for row in self.rows])
        array.setflags(write=False)
        return array

    def balls(self) -> Matrix:
        """Rationals where every entry is rational, else balls at the working precision of flint."""
        from cdobs_cli.exact.matrix import Matrix

        return Matrix.from_exact(self)

    def texts(self) -> list[list[str]]:
        """Each entry as text that reads back to the same number."""
        return [[str(entry) for entry in row] for row in self.rows]

    @staticmethod
    def from_document(rows: Any) -> ExactMatrix:
        """What `texts` wrote. Raises: TypeError, ValueError on anything else."""
        is_list = isinstance(rows, list) and all(isinstance(row, list) for row in rows)
        if not is_list or not all(isinstance(text, str) for row in rows for text in row):
            raise TypeError("a matrix is a list of rows of texts")
        return ExactMatrix(rows)

    @staticmethod
    def from_floats(array: NDArray[np.float64] | Sequence[Sequence[float]], digits: int) -> ExactMatrix:
        """The matrix rounded to short decimals: what is printed, run and proved."""
        return ExactMatrix([[decimal_text(float(value), digits) for value in row] for row in array])


def decimal_text(value: float | Fraction, digits: int) -> str:
    """The nearest decimal with so many significant digits, e.g. `1.8361`."""
    exact = Fraction(value)
    rounded = Context(prec=digits).divide(Decimal(exact.numerator), Decimal(exact.denominator))
    return plain_decimal(rounded)


_MAX_SIZE = 4000


def arb_fraction(value: arb) -> Fraction:
    """The exact rational value of an exact ball (a dyadic number)."""
    mantissa, exponent = value.man_exp()
    return Fraction(int(mantissa)) * Fraction(2) ** int(exponent)


def fmpq_fraction(value: fmpq) -> Fraction:
    """The same rational, as Python's."""
    return Fraction(int(value.p), int(value.q))


def lower_text(value: arb, digits: int = 12) -> str:
    """A decimal not above any point of the ball; `-inf` where it is unbounded, `inf` for infinity itself."""
    return _directed(value.lower(), digits, ROUND_FLOOR, "-inf")


def upper_text(value: arb, digits: int = 12) -> str:
    """A decimal not below any point of the ball; `inf` where it is unbounded, `-inf` for minus infinity itself."""
    return _directed(value.upper(), digits, ROUND_CEILING, "inf")


def text_below(number: Exact) -> str:
    """A decimal not above the number: the number itself where it is a decimal."""
    return str(number) if number.rational is not None and "/" not in str(number) else lower_text(number.ball())


def clipped(end: arb, *, up: bool) -> Fraction | None:
    """A rational on the given side of an exact finite ball, of bounded length; None where that is infinite.

    Beyond 2^4000 the way out is infinity and the way in 2^4000; within 2^-4000 of zero likewise 2^-4000 and 0.
    """
    mantissa, exponent = end.man_exp()
    size = int(exponent) + int(mantissa).bit_length()
    if mantissa == 0 or abs(size) < _MAX_SIZE:
        return arb_fraction(end)
    outward = (mantissa > 0) == up
    sign = 1 if mantissa > 0 else -1
    if size > 0:
        return None if outward else sign * Fraction(2) ** _MAX_SIZE
    return sign * Fraction(2) ** -_MAX_SIZE if outward else Fraction(0)


def _directed(end: arb, digits: int, rounding: str, unbounded: str) -> str:
    if not end.is_finite() and (end > 0 or end < 0):  # infinity itself, not an end that is not known
        return "inf" if end > 0 else "-inf"
    exact = clipped(end, up=rounding == ROUND_CEILING) if end.is_finite() else None
    if exact is None:
        return unbounded
    context = Context(prec=digits, rounding=rounding)
    return plain_decimal(context.divide(Decimal(exact.numerator), Decimal(exact.denominator)))
