"""C from expressions: one generator over our own trees, never over typed text.

    static void name(double t, const double *y, .., double *out)   out[k] = expression k

Common parts are computed once. A value that is undefined is nan or inf, as it is for arrays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from cdobs_cli.exact.expression import Call, Constant, Expression, Number, Power, Variable
from cdobs_cli.exact.language import LANGUAGE

# What the code of the language calls and C does not have; a nan stays one.
PRELUDE = """\
#include <math.h>

static inline double sign(double a) { return a > 0.0 ? 1.0 : a < 0.0 ? -1.0 : a; }
static inline double min(double a, double b) { return (a < b || a != a) ? a : b; }
static inline double max(double a, double b) { return (a > b || a != a) ? a : b; }
"""
_MOST_FACTORS = 4  # of a power that is written out


def c_function(name: str, signature: str, rows: Sequence[Expression], places: Mapping[str, str]) -> str:
    """One C function that writes all values into `out`.

    Args:
        signature: its arguments before `double *out`.
        places: what C reads for each variable, e.g. {"theta": "y[0]"}.

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
                local[node] = _constant(node)
            else:
                lines.append(f"    const double v{len(lines)} = {_code(node, local)};")
                local[node] = f"v{len(lines) - 1}"
    lines += [f"    out[{k}] = {local[row]};" for k, row in enumerate(rows)]
    return "\n".join([f"static void {name}({signature}, double *out)", "{", *lines, "}", ""])


def number(value: float) -> str:
    """A double as C reads it, to the last bit."""
    if value != value:
        return "(double)NAN"
    if abs(value) == math.inf:
        return "HUGE_VAL" if value > 0 else "(-HUGE_VAL)"
    text = repr(value)
    return f"({text})" if value < 0 else text if any(mark in text for mark in ".e") else f"{text}.0"


def _constant(node: Number | Constant) -> str:
    if isinstance(node, Number):
        return number(float(node.value))
    return number(math.pi if node.name == "pi" else math.e)


def _code(node: Expression, local: Mapping[Expression, str]) -> str:
    arguments = [local[child] for child in node.children]
    if isinstance(node, Power):
        (base,), exponent = arguments, node.exponent
        factors = abs(exponent)
        if factors.denominator > 1 or factors > _MOST_FACTORS:
            return f"pow({base}, {number(float(exponent))})"
        written = " * ".join([base] * int(factors)) or "1.0"
        return written if exponent > 0 else f"1.0 / ({written})"
    assert isinstance(node, Call)
    function = LANGUAGE[node.function]
    called = f"{function.c or node.function}({', '.join(arguments)})"
    return function.code.format(*arguments) if function.code else called
