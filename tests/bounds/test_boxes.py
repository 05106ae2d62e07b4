"""Random expressions over random boxes: no sampled point leaves a range, a gradient bound or the canonical form."""

import random
from fractions import Fraction

import numpy as np
import pytest
from flint import arb

from cdobs_cli.bounds.boxes import Evaluator
from cdobs_cli.bounds.ranges import LINE, Range, range_of
from cdobs_cli.exact.expression import Constant, ExpressionError, Number, Variable, call, power
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.language import TYPED_FUNCTIONS, applied
from cdobs_cli.exact.parser import parse
from cdobs_cli.exact.rational import is_zero, simplify

NAMES = ("x", "y")
UNARY = [name for name, counts in TYPED_FUNCTIONS.items() if 1 in counts]
POWERS = ["2", "3", "-1", "-2", "1/2", "3/2", "-1/2", "4", "1.37", "-0.148"]
BINARY = [name for name, counts in TYPED_FUNCTIONS.items() if 2 in counts]


def random_expression(source, depth):
    if depth == 0 or source.random() < 0.15:
        number = Number(Fraction(source.randint(-30, 30), 10))
        return source.choice([Variable("x"), Variable("y"), Variable("x"), Variable("y"), number, Constant("pi")])
    a = random_expression(source, depth - 1)
    kind = source.random()
    try:
        if kind < 0.55:
            function = source.choice(["add", "add", "multiply", "multiply", "divide", *BINARY])
            return applied(function, (a, random_expression(source, depth - 1)))
        if kind < 0.65:
            return power(a, Fraction(source.choice(POWERS)))
        if kind < 0.7:
            return call("sat", a, Number(Fraction(-3, 10)), Number(Fraction(7, 10)))
        return applied(source.choice(UNARY), (a,))
    except ExpressionError:
        return a


def violations(seed, expressions, points):
    """Sampled points at which an enclosure fails, and how many points were judged."""
    source = random.Random(seed)
    found, judged = [], 0
    for _ in range(expressions):
        expression = random_expression(source, source.randint(1, 5))
        short = simplify(expression)
        low = np.array([[source.uniform(-3, 3) for _ in NAMES] for _ in range(8)])
        width = np.array([[10 ** source.uniform(-4, 0.5) * (source.random() > 0.1) for _ in NAMES] for _ in range(8)])
        low[0] = 0.0
        high = low + width
        jet = Evaluator(expression, NAMES).jet(low, high)
        slopes = [expression.derivative(name) for name in NAMES]
        zero = (np.zeros(8), np.zeros(8))
        for box in range(8):
            exact = range_of(
                expression, {name: Range(Fraction(low[box, j]), Fraction(high[box, j])) for j, name in enumerate(NAMES)}
            )
            for _ in range(points):
                point = low[box] + width[box] * [source.choice([0, 1, source.random()]) for _ in NAMES]
                env = {
                    name: fraction_ball(Fraction(float(at)))
                    for name, at in zip(NAMES, np.minimum(point, high[box]), strict=True)
                }
                value = expression.ball(env)
                if not value.is_finite():
                    continue
                judged += 1
                if value < arb(float(jet.value[0][box])) or value > arb(float(jet.value[1][box])):
                    found.append(("value", expression, env))
                if not isinstance(exact.lower, float) and value < fraction_ball(exact.lower):
                    found.append(("range", expression, env))
                if not isinstance(exact.upper, float) and value > fraction_ball(exact.upper):
                    found.append(("range", expression, env))
                again = short.ball(env)
                if again.is_finite() and not again.overlaps(value):
                    found.append(("canonical form", expression, env))
                for j, slope in enumerate(slopes):
                    at = slope.ball(env)
                    lower, upper = (end[box] for end in jet.gradient.get(j, zero))
                    if at.is_finite() and (at < arb(float(lower)) or at > arb(float(upper))):
                        found.append(("gradient", expression, env))
    return found, judged


def test_no_sampled_point_leaves_an_enclosure():
    found, judged = violations(seed=3, expressions=150, points=8)
    assert judged > 5000
    assert not found


@pytest.mark.parametrize(
    ("text", "box", "lower", "upper"),
    [
        ("cos(x)", LINE, -1, 1),
        ("1 - tanh(x)**2", LINE, 0, 1),
        ("1.3 - 0.3*cos(x)", LINE, 1, Fraction(8, 5)),
        ("1/(1 + x**2)", LINE, 0, 1),
        ("exp(-x**2)", LINE, 0, 1),
        ("x**(1/2)", Range(Fraction(0), Fraction(1)), 0, 1),
        ("0.3 - 0.1*x**2", Range(Fraction(-1), Fraction(2)), Fraction(-1, 10), Fraction(3, 10)),
    ],
)
def test_attained_ends_are_exact_numbers(text, box, lower, upper):
    assert range_of(parse(text, frozenset("x")), {"x": box}) == Range(Fraction(lower), Fraction(upper))


@pytest.mark.parametrize(
    ("text", "short"),
    [
        ("x/x", "1"),
        ("(x**2 - y**2)/(x + y)", "x - y"),
        ("sin(x + 0)*y/sin(2*x - x)", "y"),
        ("contois(x, y, 2)*(x + 2*y)", "x"),
        ("x**(3/2)/x**(1/2)", "x"),
        ("x**1.852/x**0.852", "x"),
        ("(1 + x)**1.37/(2*(1 + x)**0.37)", "(1 + x)/2"),
        ("tan(atan(x*y)) + sin(asin(y)) - cos(acos(y))", "x*y"),
        ("pi*x/(2*pi)", "x/2"),
        ("1/(1 + 1/x**2)", "x**2/(x**2 + 1)"),
    ],
)
def test_the_canonical_form_cancels(text, short):
    names = frozenset(NAMES)
    assert simplify(parse(text, names)) == simplify(parse(short, names))
    assert is_zero(parse(f"{text} - ({short})", names))
    assert not is_zero(parse(f"{text} - ({short}) + 1e-9*x", names))


def test_what_is_printed_reads_back_to_the_same_tree():
    source = random.Random(5)
    for _ in range(300):
        expression = simplify(random_expression(source, 4))
        if not any(str(node).startswith(("sign", "step")) for node in expression.walk()):
            again = parse(str(expression), frozenset(NAMES))
            env = {"x": arb("0.71"), "y": arb("1.37")}
            first, second = expression.ball(env), again.ball(env)
            assert not first.is_finite() or first.overlaps(second)
