"""Expressions as mathematics: one small tree of typeset pieces, printed as LaTeX (Markdown) and as MathML (HTML)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from decimal import ROUND_DOWN, Context, Decimal
from fractions import Fraction
from html import escape

from cdobs_cli.exact.expression import MAX_ROOT, MINUS_ONE, Call, Constant, Expression, Number, Power, Variable
from cdobs_cli.exact.language import LANGUAGE
from cdobs_cli.exact.numbers import Exact, ExactMatrix, fraction_text, plain_decimal
from cdobs_cli.records import dataclass

# A longer formula is named by its size: nobody reads it, and sharing inside a tree can make it exponentially long.
MAX_OPERATIONS = 400
MAX_DEPTH = 60
# Longer numbers inside formulas are cut, with dots: the gain itself is shown in full.
LONGEST_NUMBER = 24
SHOWN_DIGITS = 17

_NAMES = (
    "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi omicron pi rho sigma tau upsilon phi chi "
    "psi omega Gamma Delta Theta Lambda Xi Pi Sigma Upsilon Phi Psi Omega"
)
GREEK = dict(zip(_NAMES.split(), "αβγδεζηθικλμνξοπρστυφχψωΓΔΘΛΞΠΣΥΦΨΩ", strict=True))
_LATEX_SYMBOLS = {"·": r"\cdot", "−": "-", "∈": r"\in", "≤": r"\le", "≥": r"\ge", "…": r"\dots", "→": r"\to"}
_ACCENTS = {"hat": "hat", "lower": "underline", "upper": "overline"}
_OPERATORS = frozenset(one.typeset[1:].partition("_")[0] for one in LANGUAGE.values() if one.typeset.startswith("\\"))


@dataclass(frozen=True)
class Formula:
    """A typeset piece."""


@dataclass(frozen=True)
class Token(Formula):
    """A piece of text."""

    text: str


class Symbol(Token):
    """A letter, a Greek letter by name, or an upright word."""


class Digits(Token):
    """A number as text."""


class Operator(Token):
    """+, −, =, brackets, commas."""


class Words(Token):
    """Plain words inside a formula."""


# The invisible sign between a function and its argument: no space where factors have one.
APPLIED = Operator("\u2061")


@dataclass(frozen=True)
class Row(Formula):
    """Pieces side by side."""

    parts: tuple[Formula, ...]


@dataclass(frozen=True)
class Ratio(Formula):
    """A fraction with a bar."""

    top: Formula
    bottom: Formula


@dataclass(frozen=True)
class Script(Formula):
    """A base with a subscript, a superscript, or both."""

    base: Formula
    below: Formula | None = None
    above: Formula | None = None


@dataclass(frozen=True)
class Root(Formula):
    """A square root."""

    body: Formula


@dataclass(frozen=True)
class Fenced(Formula):
    """A body between brackets that grow with it."""

    left: str
    body: Formula
    right: str


@dataclass(frozen=True)
class Accent(Formula):
    """dot, hat, underline or overline on a symbol."""

    body: Formula
    kind: str


@dataclass(frozen=True)
class Array(Formula):
    """A matrix without brackets."""

    rows: tuple[tuple[Formula, ...], ...]


@dataclass(frozen=True)
class Equation:
    """left = right (or another relation)."""

    left: Formula
    right: Formula
    relation: str = "="


# ---------------------------------------------------------------- from expressions


def name_formula(name: str) -> Formula:
    """A user's name: `theta` is θ, `x1` and `x_1` are x with index 1, `hat.x` and `x_hat` wear a hat, `z_lower.0` is
    z underlined with index 1."""
    head, dot, rest = name.partition(".")
    if dot and rest.isdigit():
        return _indexed(name_formula(head), str(int(rest) + 1))
    if dot:
        return _accented(rest, head) if head in _ACCENTS else _indexed(name_formula(rest), head)
    stem, _, last = name.rpartition("_")
    if stem and last in _ACCENTS:
        return _accented(stem, last)
    match = re.fullmatch(r"([A-Za-z]+?)_?(\d+)", name) or re.fullmatch(r"([A-Za-z]+?)_(\w+)", name)
    return _indexed(Symbol(match[1]), match[2]) if match else Symbol(name)


def _indexed(base: Formula, index: str) -> Formula:
    """base with an index, behind the one it may have."""
    below: Formula = Digits(index) if index.isdigit() else Symbol(index)
    if isinstance(base, Script) and base.below is not None:
        return Script(base.base, Row((base.below, Operator(","), below)), base.above)
    return Script(base, below)


def _accented(name: str, accent: str) -> Formula:
    inner = name_formula(name)
    if isinstance(inner, Script):
        return Script(Accent(inner.base, _ACCENTS[accent]), inner.below, inner.above)
    return Accent(inner, _ACCENTS[accent])


def formula(expression: Expression) -> Formula:
    """The typeset form of an expression; its size in words where it is too long to read."""
    depth: dict[Expression, int] = {}
    size: dict[Expression, int] = {}
    for node in expression.walk():
        depth[node] = 1 + max((depth[child] for child in node.children), default=0)
        size[node] = 1 + sum(size[child] for child in node.children)
    if depth[expression] > MAX_DEPTH or size[expression] > MAX_OPERATIONS:
        return Words(f"(an expression of {size[expression]} terms)")
    return _sum(expression)


def matrix(value: ExactMatrix) -> Formula:
    """A matrix of exact numbers in brackets, every digit shown."""
    return Fenced("[", Array(tuple(tuple(exact(number) for number in row) for row in value.rows)), "]")


def exact(number: Exact) -> Formula:
    """A number, every digit shown."""
    return formula(number.expression) if number.rational is None else Digits(str(number))


def _terms(node: Expression) -> list[tuple[bool, Expression]]:
    """The summands of an expression, each with whether it is subtracted."""
    if isinstance(node, Call) and node.function == "add":
        return [term for child in node.children for term in _terms(child)]
    negative, rest = _split_sign(node)
    return [(negative, rest)]


def _split_sign(node: Expression) -> tuple[bool, Expression]:
    if isinstance(node, Number) and node.value < 0:
        return True, Number(-node.value)
    if isinstance(node, Call) and node.function in ("multiply", "divide"):
        left, right = node.children
        if node.function == "multiply" and left == MINUS_ONE:
            negative, rest = _split_sign(right)
            return not negative, rest
        negative, rest = _split_sign(left)
        if negative:
            return True, Call(node.function, (rest, right))
    return False, node


def _sum(node: Expression) -> Formula:
    parts: list[Formula] = []
    for index, (negative, term) in enumerate(_terms(node)):
        if negative:
            parts.append(Operator("−"))
        elif index:
            parts.append(Operator("+"))
        # a - (b + c): a sum behind a minus keeps its brackets.
        parts.append(_fence(_sum(term)) if negative and _is_sum(term) else _product(term))
    return _row(parts)


def _row(parts: list[Formula]) -> Formula:
    return parts[0] if len(parts) == 1 else Row(tuple(parts))


def _is_sum(node: Expression) -> bool:
    return len(_terms(node)) > 1 or _split_sign(node)[0]


def _fence(body: Formula) -> Formula:
    return Fenced("(", body, ")")


def applied(function: Formula, argument: Formula) -> Formula:
    """function(argument)."""
    return Row((function, APPLIED, _fence(argument)))


def _factors(node: Expression) -> list[Expression]:
    if isinstance(node, Call) and node.function == "multiply":
        return [factor for child in node.children for factor in _factors(child)]
    return [node]


def _product(node: Expression) -> Formula:
    factors = _factors(node)
    if len(factors) == 1:
        return _atom(node)
    parts: list[Formula] = []
    for factor in factors:
        if parts and isinstance(factor, Number):
            parts.append(Operator("·"))
        parts.append(_fence(_sum(factor)) if _is_sum(factor) else _atom(factor))
    return Row(tuple(parts))


def _atom(node: Expression) -> Formula:
    if isinstance(node, Number):
        text = fraction_text(node.value)
        if len(text) > LONGEST_NUMBER:
            context = Context(prec=SHOWN_DIGITS, rounding=ROUND_DOWN)
            value = context.divide(Decimal(node.value.numerator), Decimal(node.value.denominator))
            return Digits(f"{plain_decimal(value)}…")
        if "/" in text:
            return Ratio(Digits(str(node.value.numerator)), Digits(str(node.value.denominator)))
        return Digits(text)
    if isinstance(node, Constant):
        return Symbol(node.name)
    if isinstance(node, Variable):
        return name_formula(node.name)
    if isinstance(node, Power):
        return _power(node.base, node.exponent)
    assert isinstance(node, Call)
    if node.function in ("add", "multiply"):
        return _fence(_sum(node))
    return _function(node)


def _power(base: Expression, exponent: Fraction) -> Formula:
    above = Words(str(exponent)) if 1 < exponent.denominator <= MAX_ROOT else _sum(Number(exponent))
    if exponent == Fraction(1, 2):
        return Root(_sum(base))
    named = isinstance(base, Call) and LANGUAGE[base.function].typeset.startswith("\\")
    if isinstance(base, Call) and named and exponent.denominator == 1 and exponent > 1:
        return applied(_raised(_name(base), above), _list(base.children))
    whole = isinstance(base, Number) and base.value >= 0 and base.value.denominator == 1
    if whole or isinstance(base, Variable | Constant):
        return _raised(_atom(base), above)
    return Script(_fence(_sum(base)), None, above)


def _raised(base: Formula, above: Formula) -> Formula:
    """base to the power above, behind the index it may have."""
    if isinstance(base, Script) and base.above is None:
        return Script(base.base, base.below, above)
    return Script(base, None, above)


def _list(arguments: Sequence[Expression]) -> Formula:
    return _row([part for argument in arguments for part in (Operator(","), _sum(argument))][1:])


def _function(node: Call) -> Formula:
    a = node.children
    match node.function:
        case "divide":
            return Ratio(_sum(a[0]), _sum(a[1]))
        case "sqrt":
            return Root(_sum(a[0]))
        case "abs":
            return Fenced("|", _sum(a[0]), "|")
        case "exp":
            return Script(Symbol("e"), None, _sum(a[0]))
        case "sat":
            limits = Fenced("[", Row((_sum(a[1]), Operator(","), _sum(a[2]))), "]")
            return applied(Script(_name(node), limits), _sum(a[0]))
    return applied(_name(node), _list(a))


def _name(node: Call) -> Formula:
    """The function's name, with its index."""
    name, _, index = LANGUAGE[node.function].typeset.lstrip("\\").partition("_")
    return Script(Symbol(name), Digits(index)) if index else Symbol(name)


# ---------------------------------------------------------------- LaTeX


def latex(piece: Formula) -> str:
    """LaTeX for mathematics mode."""
    match piece:
        case Symbol(name):
            return _latex_name(name)
        case Digits(text):
            return re.sub(r"e(-?\d+)", r"\\mathrm{e}\1", text).replace("…", r"\dots")
        case Operator(text):
            return _LATEX_SYMBOLS.get(text, text)
        case Words(text):
            return rf"\text{{{_latex_text(text)}}}"
        case Row(parts):
            return " ".join(latex(part) for part in parts if part != APPLIED)
        case Ratio(top, bottom):
            return rf"\frac{{{latex(top)}}}{{{latex(bottom)}}}"
        case Script(base, below, above):
            text = latex(base)
            text += rf"_{{{latex(below)}}}" if below is not None else ""
            return text + (rf"^{{{latex(above)}}}" if above is not None else "")
        case Root(body):
            return rf"\sqrt{{{latex(body)}}}"
        case Fenced(left, body, right):
            return rf"\left{left} {latex(body)} \right{right}"
        case Accent(body, kind):
            return rf"\{kind}{{{latex(body)}}}"
        case Array(rows):
            lines = r" \\ ".join(" & ".join(latex(cell) for cell in row) for row in rows)
            return rf"\begin{{matrix}} {lines} \end{{matrix}}"
    raise TypeError(type(piece).__name__)


def _latex_name(name: str) -> str:
    if (name in GREEK and name != "omicron") or name in _OPERATORS:
        return f"\\{name}"
    return name if len(name) == 1 else rf"\mathrm{{{_latex_text(name)}}}"


def _latex_text(text: str) -> str:
    return re.sub(r"([#$%&_{}])", r"\\\1", re.sub(r"[\\^~]", " ", text))


def latex_block(equations: Sequence[Equation]) -> str:
    """Aligned equations."""
    lines = " \\\\\n".join(f"{latex(e.left)} &{latex(Operator(e.relation))} {latex(e.right)}" for e in equations)
    return f"\\begin{{aligned}}\n{lines}\n\\end{{aligned}}"


# ---------------------------------------------------------------- MathML


def mathml(piece: Formula) -> str:
    """Presentation MathML (the Core subset that browsers draw)."""
    match piece:
        case Symbol(name):
            return f"<mi>{escape(GREEK.get(name, name))}</mi>"
        case Digits(text):
            return f"<mn>{escape(text.replace('-', '−'))}</mn>"
        case Operator(text):
            # In ASCII: a page shows invisible characters as escapes.
            return f"<mo>{escape(text).encode('ascii', 'xmlcharrefreplace').decode()}</mo>"
        case Words(text):
            return f"<mtext>{escape(text)}</mtext>"
        case Row(parts):
            return f"<mrow>{_mathml_row(parts)}</mrow>"
        case Ratio(top, bottom):
            return f"<mfrac>{mathml(top)}{mathml(bottom)}</mfrac>"
        case Script(base, below, above):
            if below is None:
                return f"<msup>{mathml(base)}{mathml(above or Row(()))}</msup>"
            if above is None:
                return f"<msub>{mathml(base)}{mathml(below)}</msub>"
            return f"<msubsup>{mathml(base)}{mathml(below)}{mathml(above)}</msubsup>"
        case Root(body):
            return f"<msqrt>{mathml(body)}</msqrt>"
        case Fenced("[", Array(), "]"):
            # Brackets by style: stretching needs a mathematics font, which few machines have.
            return f'<mrow class="matrix">{mathml(piece.body)}</mrow>'
        case Fenced(left, body, right):
            fence = '<mo fence="true" stretchy="true">{}</mo>'
            return f"<mrow>{fence.format(escape(left))}{mathml(body)}{fence.format(escape(right))}</mrow>"
        case Accent(body, kind):
            if kind == "underline":
                return f'<munder accentunder="true">{mathml(body)}<mo stretchy="true">_</mo></munder>'
            mark, stretchy = {"dot": "˙", "hat": "^", "overline": "¯"}[kind], str(kind == "overline").lower()
            return f'<mover accent="true">{mathml(body)}<mo stretchy="{stretchy}">{mark}</mo></mover>'
        case Array(rows):
            lines = "".join("<mtr>" + "".join(f"<mtd>{mathml(cell)}</mtd>" for cell in row) + "</mtr>" for row in rows)
            return f"<mtable>{lines}</mtable>"
    raise TypeError(type(piece).__name__)


def _mathml_row(parts: Sequence[Formula]) -> str:
    """Pieces with a thin space where two factors meet, an unspaced sign where one leads."""
    text = ""
    for index, part in enumerate(parts):
        if index and not isinstance(part, Operator) and not isinstance(parts[index - 1], Operator):
            text += '<mspace width="0.17em"></mspace>'
        text += f'<mo form="prefix">{part.text}</mo>' if index == 0 and isinstance(part, Operator) else mathml(part)
    return text


def mathml_block(equations: Sequence[Equation]) -> str:
    """Aligned equations as a table without lines."""
    rows = "".join(
        f"<mtr><mtd>{mathml(e.left)}</mtd><mtd><mo>{escape(e.relation)}</mo></mtd><mtd>{mathml(e.right)}</mtd></mtr>"
        for e in equations
    )
    return f'<math displaystyle="true"><mtable class="aligned">{rows}</mtable></math>'
