"""Expressions compiled to float functions: of plain floats for one run, of arrays for many.

The code is written from our own tree (never from the typed text) with numbered locals, so it can only
contain arithmetic and the functions of the language.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

from cdobs_cli.exact.expression import Call, Constant, Expression, Number, Power, Variable
from cdobs_cli.exact.language import LANGUAGE

Compiled = Callable[..., tuple[Any, ...]]


@cache
def _table(*, arrays: bool) -> dict[str, Any]:
    """The functions that code may call: of floats, or numpy's."""
    if not arrays:
        return {"power": math.pow} | {name: function.scalar for name, function in LANGUAGE.items() if function.scalar}
    import numpy as np

    called = {name: function.array or name for name, function in LANGUAGE.items() if not function.code}
    return {name: getattr(np, theirs) for name, theirs in {"power": "power", **called}.items()}


def _code(node: Expression, local: dict[Expression, str]) -> str:
    if isinstance(node, Number):
        return repr(float(node.value))
    if isinstance(node, Constant):
        return repr(math.pi if node.name == "pi" else math.e)
    arguments = [local[child] for child in node.children]
    if isinstance(node, Power):
        (base,), exponent = arguments, node.exponent
        if exponent == 2:
            return f"{base} * {base}"
        return f"{base} ** {exponent.numerator}" if exponent.denominator == 1 else f"power({base}, {float(exponent)!r})"
    assert isinstance(node, Call)
    code = LANGUAGE[node.function].code
    return code.format(*arguments) if code else f"{node.function}({', '.join(arguments)})"


def compile_floats(expressions: Sequence[Expression], names: Sequence[str], *, arrays: bool) -> Compiled:
    """One function of `names`, in that order, that returns the tuple of all values.

    Args:
        expressions: any number of trees; common parts are computed once.
        names: variable names; the function takes them as positional arguments.
        arrays: numpy arrays (broadcast) when true, Python floats when false. Floats raise
            ValueError, ZeroDivisionError or OverflowError where arrays give nan or inf.
    """
    table: dict[str, Any] = {"__builtins__": {}} | _table(arrays=arrays)
    source = python_function("function", expressions, names)
    exec(compile(source, "<compiled expression>", "exec"), table)  # noqa: S102 - our own code, see the module's text
    function: Compiled = table["function"]
    return function


def python_function(name: str, expressions: Sequence[Expression], names: Sequence[str]) -> str:
    """The text of such a function; it calls the functions of the language, and `power`, by their names."""
    local: dict[Expression, str] = {}
    arguments = {name: f"a{index}" for index, name in enumerate(names)}
    lines: list[str] = []
    for expression in expressions:
        for node in expression.walk(local):
            if isinstance(node, Variable):
                local[node] = arguments[node.name]
            elif isinstance(node, Number | Constant):
                local[node] = f"({_code(node, local)})"
            else:
                lines.append(f"    v{len(lines)} = {_code(node, local)}")
                local[node] = f"v{len(lines) - 1}"
    results = "".join(f"{local[expression]}, " for expression in expressions)
    return "\n".join([f"def {name}({', '.join(arguments.values())}):", *lines, f"    return ({results})", ""])
