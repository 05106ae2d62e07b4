"""Plant and observer as displayed equations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import islice

from cdobs_cli.exact.expression import ZERO, Call, Expression, Number, Variable
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.hybrid import Observer
from cdobs_cli.plant import Plant, TypedDynamics, weighted
from cdobs_cli.report import equations as typeset
from cdobs_cli.report.equations import Equation, Formula, Script, Symbol, formula, name_formula

MAX_EQUATIONS = 24


def dotted(piece: Formula) -> Formula:
    """The time derivative of a symbol: a dot, d/dt before a word."""
    symbol = piece.base if isinstance(piece, Script) else piece
    if isinstance(symbol, Symbol) and len(symbol.text) > 1 and symbol.text not in typeset.GREEK:
        return typeset.Row(
            (typeset.Ratio(Symbol("d"), typeset.Row((Symbol("d"), typeset.APPLIED, Symbol("t")))), piece)
        )
    if isinstance(piece, Script):
        return Script(typeset.Accent(piece.base, "dot"), piece.below, piece.above)
    return typeset.Accent(piece, "dot")


def after_jump(piece: Formula) -> Formula:
    """A symbol just after a sample: a raised plus."""
    if isinstance(piece, Script):
        return Script(piece.base, piece.below, typeset.Operator("+"))
    return Script(piece, None, typeset.Operator("+"))


def plant_equations(plant: Plant) -> tuple[Equation, ...]:
    """xdot = A x + B u + phi(x, u) + d, written out, and y = C x + v."""
    rows = []
    for i in range(plant.n):
        total = sum(weighted(plant.A, i, map(Variable, plant.states)), ZERO)
        if plant.B is not None:
            total = total + sum(weighted(plant.B, i, (Variable(source.name) for source in plant.inputs)), ZERO)
        total = total + plant.phi[i]
        rows.append(total + Variable(f"d.{i}") if plant.is_disturbed else total)
    return _equations(map(dotted, map(name_formula, plant.states)), rows)


def output_equations(plant: Plant) -> tuple[Equation, ...]:
    """What is measured at t_k."""
    names = (typeset.applied(name, Script(Symbol("t"), Symbol("k"))) for name in _outputs(plant.p))
    rows = plant.outputs()
    return _equations(names, [row + Variable(f"v.{k}") if plant.is_noisy else row for k, row in enumerate(rows)])


def _outputs(count: int) -> list[Formula]:
    """y, or y_1, y_2, .."""
    return [Symbol("y")] if count == 1 else [Script(Symbol("y"), typeset.Digits(str(k + 1))) for k in range(count)]


def typed_equations(typed: TypedDynamics) -> tuple[Equation, ...]:
    """xdot = f(x, u) + d in the user's states."""
    disturbed = typed.disturbance is not None or typed.intensity is not None
    rows = [one + Variable(f"d.{i}") if disturbed else one for i, one in enumerate(typed.dynamics)]
    return _equations(map(dotted, map(name_formula, typed.states)), rows)


def typed_outputs(typed: TypedDynamics) -> tuple[Equation, ...]:
    """y = h(x)."""
    return _equations(_outputs(len(typed.output)), typed.output)


def map_equations(names: Sequence[str], map_: Sequence[Expression]) -> tuple[Equation, ...]:
    """z = map(x)."""
    return _equations(map(name_formula, names), map_)


def flow_equations(observer: Observer) -> tuple[Equation, ...]:
    """The observer between samples."""
    return _equations(map(dotted, map(name_formula, observer.states)), observer.flow)


def jump_equations(observer: Observer, outputs: int, number: int = 0) -> tuple[Equation, ...]:
    """The observer at a sample, or at the one of this number; states that do not jump are left out."""
    rows = [one.substitute(_alone(outputs)) for one in (observer.jumps[number] if observer.jumps else observer.jump)]
    jumps = {name: jump for name, jump in zip(observer.states, rows, strict=True) if jump != Variable(name)}
    return _equations(map(after_jump, map(name_formula, jumps)), jumps.values())


def held_equations(observer: Observer) -> tuple[Equation, ...]:
    """Inputs held from one sample to the next."""
    return _equations(map(name_formula, observer.control), observer.control.values())


def signal_equations(signals: Mapping[str, Expression], outputs: int) -> tuple[Equation, ...]:
    """The inputs of a simulation, over time, estimates and the last measurement."""
    shown = (signal.substitute(_alone(outputs)) for signal in signals.values())
    return _equations(map(name_formula, signals), shown)


def _alone(outputs: int) -> dict[str, Expression]:
    """The only output has no number."""
    return {"y.0": Variable("y")} if outputs == 1 else {}


def _equations(left: Iterable[Formula], right: Iterable[Expression]) -> tuple[Equation, ...]:
    pairs = islice(zip(left, right, strict=False), MAX_EQUATIONS)
    return tuple(Equation(name, formula(cancelled(one))) for name, one in pairs)


def cancelled(expression: Expression) -> Expression:
    """The sum without what it adds and takes away again: x + (y - x) is y. As it stands where nothing cancels."""
    if expression.size > typeset.MAX_OPERATIONS or expression.depth > typeset.MAX_DEPTH:
        return expression
    weights: dict[Expression, Fraction] = {}
    pending = [(expression, Fraction(1))]
    while pending:
        node, weight = pending.pop()
        if isinstance(node, Call) and node.function == "add":
            pending += [(child, weight) for child in reversed(node.children)]
        elif isinstance(node, Call) and node.function == "multiply" and isinstance(node.children[0], Number):
            pending.append((node.children[1], weight * node.children[0].value))
        else:
            weights[node] = weights.get(node, Fraction(0)) + weight
    if all(weights.values()):
        return expression
    return sum((Number(weight) * node for node, weight in weights.items() if weight), ZERO)


def gain_equations(gain: Mapping[str, ExactMatrix]) -> tuple[Equation, ...]:
    """Each gain by its letter; a 1 x 1 matrix as a number."""
    values = {
        name: typeset.exact(one[0, 0]) if one.shape == (1, 1) else typeset.matrix(one) for name, one in gain.items()
    }
    return tuple(Equation(name_formula(name), value) for name, value in values.items())
