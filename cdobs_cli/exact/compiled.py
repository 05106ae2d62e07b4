"""Expressions compiled to float functions: of plain floats for one run, of arrays for many.

The code is written from our own tree (never from the typed text) with numbered locals, so it can only
contain arithmetic and the functions of the table below.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from cdobs_cli.exact.expression import Call, Constant, Expression, Number, Power, Variable


def _scalar_table() -> dict[str, Any]:
    def sat(x: float, low: float, high: float) -> float:
        return max(low, min(x, high))

    def sign(x: float) -> float:
        return 1.0 if x > 0 else -1.0 if x < 0 else 0.0

    def step(x: float) -> float:
        return float(x > 0) if x != 0 else 0.5

    names = ("sin", "cos", "tan", "tanh", "sinh", "cosh", "exp", "log", "sqrt")
    return {name: getattr(math, name) for name in names} | {
        "abs": abs, "min": min, "max": max, "sat": sat, "sign": sign, "step": step,
    }  # fmt: skip


def _array_table() -> dict[str, Any]:
    import numpy as np

    names = ("sin", "cos", "tan", "tanh", "sinh", "cosh", "exp", "log", "sqrt", "abs", "sign")
    return {name: getattr(np, name) for name in names} | {
        "min": np.minimum, "max": np.maximum, "sat": lambda x, low, high: np.maximum(low, np.minimum(x, high)),
        "step": lambda x: np.heaviside(x, 0.5),
    }  # fmt: skip


def _code(node: Expression, local: dict[Expression, str]) -> str:
    if isinstance(node, Number):
        return repr(float(node.value))
    if isinstance(node, Constant):
        return repr(math.pi if node.name == "pi" else math.e)
    if isinstance(node, Power):
        base, exponent = local[node.base], node.exponent
        if exponent == 2:
            return f"{base} * {base}"
        return f"{base} ** {exponent.numerator}" if exponent.denominator == 1 else f"{base} ** {float(exponent)!r}"
    assert isinstance(node, Call)
    arguments = [local[child] for child in node.children]
    match node.function:
        case "add":
            return f"{arguments[0]} + {arguments[1]}"
        case "multiply":
            return f"{arguments[0]} * {arguments[1]}"
        case "divide":
            return f"{arguments[0]} / {arguments[1]}"
        case "monod":
            return f"{arguments[0]} / ({arguments[1]} + {arguments[0]})"
        case "contois":
            return f"{arguments[0]} / ({arguments[2]} * {arguments[1]} + {arguments[0]})"
        case name:
            return f"{name}({', '.join(arguments)})"


def compile_floats(expressions: Sequence[Expression], names: Sequence[str], *, arrays: bool) -> Callable[..., tuple[Any, ...]]:
    """One function of `names`, in that order, that returns the tuple of all values.

    Args:
        expressions: any number of trees; common parts are computed once.
        names: variable names; the function takes them as positional arguments.
        arrays: numpy arrays (broadcast) when true, Python floats when false. Floats raise
            ValueError, ZeroDivisionError or OverflowError where arrays give nan or inf.
    """
    local: dict[Expression, str] = {}
    arguments = {name: f"a{index}" for index, name in enumerate(names)}
    lines: list[str] = []
    for expression in expressions:
        for node in expression.walk():
            if node in local:
                continue
            if isinstance(node, Variable):
                local[node] = arguments[node.name]
            else:
                code = _code(node, local)
                if isinstance(node, Number | Constant):
                    local[node] = f"({code})"
                else:
                    local[node] = f"v{len(lines)}"
                    lines.append(f"    {local[node]} = {code}")
    results = "".join(f"{local[expression]}, " for expression in expressions)
    source = "\n".join([f"def function({', '.join(arguments.values())}):", *lines, f"    return ({results})"])
    table: dict[str, Any] = {"__builtins__": {}} | (_array_table() if arrays else _scalar_table())
    exec(compile(source, "<compiled expression>", "exec"), table)  # noqa: S102 - our own code, see the module's text
    function: Callable[..., tuple[Any, ...]] = table["function"]
    return function
