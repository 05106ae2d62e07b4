"""C from expressions: one generator over our own trees, never over typed text.

    static void name(double t, const double *y, .., double *out)   out[k] = expression k

Common parts are computed once. A value that is undefined is nan or inf, as it is for arrays. In single precision
`double` is `float` throughout, and <tgmath.h> finds the functions of it.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping, Sequence

from cdobs_cli.exact.expression import Call, Constant, Expression, Number, Power, Variable
from cdobs_cli.exact.language import LANGUAGE

DOUBLE, FLOAT = "double", "float"
# What the code of the language calls and C does not have; a nan stays one.
_OWN = {
    "sign": "static inline {0} sign({0} a) {{ return a > 0 ? 1 : a < 0 ? -1 : a; }}",
    "min": "static inline {0} min({0} a, {0} b) {{ return (a < b || a != a) ? a : b; }}",
    "max": "static inline {0} max({0} a, {0} b) {{ return (a > b || a != a) ? a : b; }}",
}
_LITERAL = re.compile(r"\b\d+\.\d+\b")
_ARGUMENT = re.compile(r"(\w+)$")
_MOST_FACTORS = 4  # of a power that is written out


def prelude(code: str, real: str = DOUBLE) -> str:
    """What comes before code: the header of the functions, and those of the language that it calls."""
    own = [text.format(real) for name, text in _OWN.items() if re.search(rf"\b{name}\(", code)]
    return "\n".join([f"#include <{'math' if real == DOUBLE else 'tgmath'}.h>", "", *own, ""])


def c_function(
    name: str, signature: str, rows: Sequence[Expression], places: Mapping[str, str], real: str = DOUBLE
) -> str:
    """One C function that writes all values into `out`.

    Args:
        signature: its arguments before `double *out`.
        places: what C reads for each variable, e.g. {"theta": "y[0]"}.
        real: the type of its numbers.

    Raises:
        KeyError: a variable without a place.
    """
    local: dict[Expression, str] = {}
    lines: list[str] = []
    for row in rows:
        for node in row.walk(local):
            if isinstance(node, Variable):
                local[node] = places[node.name]
            elif isinstance(node, Number | Constant):
                local[node] = _constant(node, real)
            else:
                lines.append(f"    const {real} v{len(lines)} = {_code(node, local, real)};")
                local[node] = f"v{len(lines) - 1}"
    lines += [f"    out[{k}] = {local[row]};" for k, row in enumerate(rows)]
    names = [found[1] for part in (*signature.split(","), "out") if (found := _ARGUMENT.search(part))]
    unread = [one for one in names if not any(re.search(rf"\b{one}\b", line) for line in lines)]
    lines = [*lines, *(f"    (void){one};" for one in unread)]
    return "\n".join([f"static void {name}({signature}, {real} *out)", "{", *lines, "}", ""])


def number(value: float, real: str = DOUBLE) -> str:
    """A number as C reads it, to the last bit of its type."""
    suffix = "f" if real == FLOAT else ""
    if real == FLOAT and abs(value) < math.inf:
        value = _single(value)
    if value != value:
        return f"({real})NAN"
    if abs(value) == math.inf:
        return f"HUGE_VAL{suffix.upper()}" if value > 0 else f"(-HUGE_VAL{suffix.upper()})"
    text = repr(value)
    text = text if any(mark in text for mark in ".e") else f"{text}.0"
    return f"({text}{suffix})" if value < 0 else f"{text}{suffix}"


def _single(value: float) -> float:
    """The nearest number of single precision."""
    try:
        rounded: float = struct.unpack("f", struct.pack("f", value))[0]
    except OverflowError:
        return math.copysign(math.inf, value)
    return rounded


def _constant(node: Number | Constant, real: str) -> str:
    if isinstance(node, Number):
        return number(float(node.value), real)
    return number(math.pi if node.name == "pi" else math.e, real)


def _code(node: Expression, local: Mapping[Expression, str], real: str) -> str:
    arguments = [local[child] for child in node.children]
    if isinstance(node, Power):
        (base,), exponent = arguments, node.exponent
        factors = abs(exponent)
        if factors.denominator > 1 or factors > _MOST_FACTORS:
            return f"pow({base}, {number(float(exponent), real)})"
        one = number(1.0, real)
        written = " * ".join([base] * int(factors)) or one
        return written if exponent > 0 else f"{one} / ({written})"
    assert isinstance(node, Call)
    function = LANGUAGE[node.function]
    called = f"{function.c or node.function}({', '.join(arguments)})"
    code = _LITERAL.sub(lambda literal: number(float(literal[0]), real), function.code)
    return code.format(*arguments) if code else called
