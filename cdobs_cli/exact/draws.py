"""Random draws of a noise as standard variables: the one place that says what `uniform` and `normal` are made of."""

from __future__ import annotations

from cdobs_cli.exact.expression import Call, Expression, Power, Variable, power

# Random functions of the language and the standard variable each one is made from.
RANDOM = ("uniform", "normal")


def is_random(expression: Expression) -> bool:
    """Whether something in it is drawn."""
    return any(isinstance(node, Call) and node.function in RANDOM for node in expression.walk())


def with_draws(node: Expression, draws: list[str]) -> Expression:
    """uniform(lo, hi) -> lo + (hi - lo) draw, normal(sigma) -> sigma draw; every occurrence is a draw of its own,
    `draw.0`, `draw.1`, .., its function appended to `draws`."""
    if not is_random(node):
        return node
    if isinstance(node, Call) and node.function in RANDOM:
        draw = Variable(f"draw.{len(draws)}")
        draws.append(node.function)
        arguments = [with_draws(child, draws) for child in node.children]
        if node.function == "normal":
            return arguments[0] * draw
        return arguments[0] + (arguments[1] - arguments[0]) * draw
    if isinstance(node, Call):
        return Call(node.function, tuple(with_draws(child, draws) for child in node.children))
    assert isinstance(node, Power)
    return power(with_draws(node.base, draws), node.exponent)
