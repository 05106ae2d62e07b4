"""Plant and observer as displayed equations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from cdobs_cli.exact.expression import ZERO, Expression, Variable
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.hybrid import Observer
from cdobs_cli.plant import Plant, TypedDynamics
from cdobs_cli.report.equations import (
    APPLIED,
    GREEK,
    Accent,
    Digits,
    Equation,
    Formula,
    Operator,
    Ratio,
    Row,
    Script,
    Symbol,
    applied,
    exact,
    formula,
    matrix,
    name_formula,
)

MAX_EQUATIONS = 24


def dotted(piece: Formula) -> Formula:
    """The time derivative of a symbol: a dot, d/dt before a word."""
    symbol = piece.base if isinstance(piece, Script) else piece
    if isinstance(symbol, Symbol) and len(symbol.name) > 1 and symbol.name not in GREEK:
        return Row((Ratio(Symbol("d"), Row((Symbol("d"), APPLIED, Symbol("t")))), piece))
    if isinstance(piece, Script):
        return Script(Accent(piece.base, "dot"), piece.below, piece.above)
    return Accent(piece, "dot")


def after_jump(piece: Formula) -> Formula:
    """A symbol just after a sample: a raised plus."""
    if isinstance(piece, Script):
        return Script(piece.base, piece.below, Operator("+"))
    return Script(piece, None, Operator("+"))


def plant_equations(plant: Plant) -> tuple[Equation, ...]:
    """xdot = A x + B u + phi(x, u) + d, written out, and y = C x + v."""
    rows = []
    for i, name in enumerate(plant.states):
        total = _row(plant.A, i, plant.states)
        if plant.B is not None:
            total = total + _row(plant.B, i, tuple(source.name for source in plant.inputs))
        total = total + plant.phi[i]
        if plant.disturbance is not None:
            total = total + Variable(f"d.{i}")
        rows.append(Equation(dotted(name_formula(name)), formula(total)))
    return tuple(rows[:MAX_EQUATIONS])


def output_equations(plant: Plant) -> tuple[Equation, ...]:
    """What is measured at t_k."""
    rows = []
    for k, output in enumerate(plant.outputs()):
        total = output if plant.noise is None else output + Variable(f"v.{k}")
        name = Script(Symbol("y"), Digits(str(k + 1))) if plant.p > 1 else Symbol("y")
        rows.append(Equation(applied(name, Script(Symbol("t"), Symbol("k"))), formula(total)))
    return tuple(rows[:MAX_EQUATIONS])


def typed_equations(typed: TypedDynamics) -> tuple[Equation, ...]:
    """xdot = f(x, u) + d in the user's states."""
    disturbed = typed.disturbance is not None
    rows = [one + Variable(f"d.{i}") if disturbed else one for i, one in enumerate(typed.dynamics)]
    return tuple(
        Equation(dotted(name_formula(name)), formula(one)) for name, one in zip(typed.states, rows, strict=True)
    )[:MAX_EQUATIONS]


def typed_outputs(typed: TypedDynamics) -> tuple[Equation, ...]:
    """y = h(x)."""
    single = len(typed.output) == 1
    names = [Symbol("y") if single else Script(Symbol("y"), Digits(str(k + 1))) for k in range(len(typed.output))]
    return tuple(Equation(name, formula(one)) for name, one in zip(names, typed.output, strict=True))[:MAX_EQUATIONS]


def map_equations(names: Sequence[str], map: Sequence[Expression]) -> tuple[Equation, ...]:
    """z = map(x)."""
    return tuple(Equation(name_formula(name), formula(one)) for name, one in zip(names, map, strict=True))[
        :MAX_EQUATIONS
    ]


def _row(matrix: ExactMatrix, i: int, names: tuple[str, ...]) -> Expression:
    total: Expression = ZERO
    for j, name in enumerate(names):
        total = total + matrix[i, j].expression * Variable(name)
    return total


def flow_equations(observer: Observer) -> tuple[Equation, ...]:
    """The observer between samples."""
    pairs = zip(observer.states, observer.flow, strict=True)
    return tuple(Equation(dotted(name_formula(name)), formula(flow)) for name, flow in pairs)[:MAX_EQUATIONS]


def jump_equations(observer: Observer) -> tuple[Equation, ...]:
    """The observer at a sample; states that do not jump are left out."""
    pairs = [(name, jump) for name, jump in zip(observer.states, observer.jump, strict=True) if jump != Variable(name)]
    return tuple(Equation(after_jump(name_formula(name)), formula(jump)) for name, jump in pairs)[:MAX_EQUATIONS]


def held_equations(observer: Observer) -> tuple[Equation, ...]:
    """Inputs held from one sample to the next."""
    return tuple(Equation(name_formula(name), formula(value)) for name, value in observer.control.items())[
        :MAX_EQUATIONS
    ]


def gain_equations(gain: Mapping[str, ExactMatrix]) -> tuple[Equation, ...]:
    """Each gain by its letter; a 1 x 1 matrix as a number."""
    return tuple(
        Equation(name_formula(name), exact(value[0, 0]) if value.shape == (1, 1) else matrix(value))
        for name, value in gain.items()
    )
