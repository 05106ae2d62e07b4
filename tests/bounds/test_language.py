"""Every function of the language in every reading: a record is tested by being there."""

from fractions import Fraction
from itertools import product
from math import inf, isnan
from xml.etree import ElementTree

import numpy as np
import pytest
from flint import arb

from cdobs_cli.bounds.boxes import Evaluator
from cdobs_cli.bounds.definedness import conditions
from cdobs_cli.bounds.ranges import LINE, Range, range_of
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.expression import Call, ExpressionError, Number, Power, Variable, call
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.language import LANGUAGE, MACROS, TYPED_FUNCTIONS, applied
from cdobs_cli.exact.parser import parse
from cdobs_cli.exact.precision import precision
from cdobs_cli.exact.shapes import Cornered, Kink
from cdobs_cli.report.equations import formula, latex, mathml

ARITY = {
    **{name: function.arity for name, function in LANGUAGE.items()},
    **{name: count for name, (count, _) in MACROS.items()},
}
NAMES = ("x", "y", "z")
POWERS = ["2", "3", "-1", "-2", "1/2", "-3/2", "2/3", "1.37", "1.852", "-0.148", "0.000001", "63.999999"]
SUBJECTS = {
    **{name: applied(name, tuple(map(Variable, NAMES[:count]))) for name, count in ARITY.items()},
    **{f"x**{exponent}": Power(Variable("x"), Fraction(exponent)) for exponent in POWERS},
}
every = pytest.mark.parametrize("name", SUBJECTS)


def names_of(name):
    return NAMES[: ARITY.get(name, 1)]


def points_of(name, count=60):
    """Rational points of short decimals, some of them whole: the ends of most domains."""
    draws = np.random.default_rng(7)
    for k in range(count):
        scale, digits = (4, 0) if k % 4 == 0 else (1, 3) if k % 4 == 1 else (5, 3)
        yield {one: Fraction(f"{draws.uniform(-scale, scale):.{digits}f}") for one in names_of(name)}


def balls(point):
    return {name: fraction_ball(at) for name, at in point.items()}


def is_defined(expression, point):
    """Whether what is said to be needed holds."""
    meets = {"positive": lambda g: g > 0, "nonnegative": lambda g: g >= 0, "nonzero": lambda g: g > 0 or g < 0}
    return all(meets[need](g.ball(balls(point))) for g, need in conditions(expression))


def shape_of(node):
    return LANGUAGE[node.function].shape if isinstance(node, Call) else None


def is_smooth(expression, point):
    """Away from kinks, and from the ends of domains."""
    kinks = [shape_of(node).condition(*node.children) for node in expression.walk() if isinstance(shape_of(node), Kink)]
    needs = [g for g, _ in conditions(expression)]
    return all(abs(g.ball(balls(point))) > 0.01 for g in (*kinks, *needs))


def test_what_may_be_typed_is_what_is_registered():
    assert set(TYPED_FUNCTIONS) == {name for name, one in LANGUAGE.items() if one.typed} | set(MACROS)
    assert not set(LANGUAGE) & set(MACROS)


@pytest.mark.parametrize("name", TYPED_FUNCTIONS)
def test_parse(name):
    for count in range(5):
        text = f"{name}({', '.join('xyzuv'[:count])})"
        if count in TYPED_FUNCTIONS[name]:
            expression = parse(text, frozenset("xyzuv"))
            assert parse(str(expression), frozenset("xyzuv")) == expression
        else:
            with pytest.raises(ExpressionError, match=f"{name} takes"):
                parse(text, frozenset("xyzuv"))


@every
def test_floats_arrays_balls_and_definedness(name):
    expression, points = SUBJECTS[name], list(points_of(name))
    scalar = compile_floats([expression], names_of(name), arrays=False)
    array = compile_floats([expression], names_of(name), arrays=True)
    with np.errstate(all="ignore"):
        (batch,) = array(*np.array([[float(at) for at in point.values()] for point in points]).T)
    defined = 0
    for point, together in zip(points, batch, strict=True):
        ball = expression.ball(balls(point))
        assert ball.is_finite() == is_defined(expression, point)
        if ball.is_finite():
            defined += 1
            alone = scalar(*map(float, point.values()))[0]
            assert alone == pytest.approx(together, rel=1e-12, abs=1e-14)
            if name not in ("sign", "step") or is_smooth(expression, point):
                assert alone == pytest.approx(float(ball.mid()), rel=1e-10, abs=1e-12)
        elif not isinstance(shape_of(expression), Cornered):  # floats have a value on the cut
            assert isnan(together) or abs(together) == inf or abs(together) > 1e15  # tan near its pole
            with pytest.raises((ValueError, ZeroDivisionError, OverflowError)):
                scalar(*map(float, point.values()))
    assert defined > 15


@every
def test_the_derivative_is_the_limit_of_differences(name):
    expression, compared = SUBJECTS[name], 0
    h = Fraction(1, 10**30)
    for point in filter(lambda point: is_smooth(expression, point) and is_defined(expression, point), points_of(name)):
        for one in names_of(name):
            with precision(400):
                sides = [expression.ball(balls({**point, one: point[one] + step})) for step in (h, -h)]
                slope = (sides[0] - sides[1]) / (2 * fraction_ball(h))
                exact = expression.derivative(one).ball(balls(point))
                assert abs(slope - exact) < arb("1e-20") * (1 + abs(exact))
            compared += 1
    assert compared > 15


def boxes_of(name):
    """Boxes of all widths round rational points: points, ends of domains, unbounded sides."""
    draws = np.random.default_rng(3)
    for point in points_of(name, 80):
        box = {}
        for one, at in point.items():
            width = Fraction(draws.choice(["0", "0.001", "0.1", "1", "4"]))
            low, high = draws.choice([0.0, 0.02], 2) * (width > 1)
            far = [wide and draws.random() < 0.2 for wide in (low, high)]
            box[one] = Range(-inf if far[0] else at, inf if far[1] else at + width)
        yield box


def outwards(end, side):
    return float(end) if float(end) == end else np.nextafter(float(end), side)


def inside(box, count=12):
    draws = np.random.default_rng(5)
    finite = [[end for end in (ends.lower, ends.upper) if isinstance(end, Fraction)] for ends in box.values()]
    yield from (dict(zip(box, corner, strict=True)) for corner in product(*(ends or [Fraction(0)] for ends in finite)))
    for _ in range(count):
        point = {}
        for one, ends in box.items():
            low = ends.lower if isinstance(ends.lower, Fraction) else min(ends.upper, 0) - 50
            high = ends.upper if isinstance(ends.upper, Fraction) else max(low, 0) + 50
            point[one] = Fraction(low) + (Fraction(high) - Fraction(low)) * Fraction(f"{draws.random():.6f}")
        yield point


@every
def test_ranges_and_boxes_hold_values_and_gradients(name):
    expression = SUBJECTS[name]
    slopes = [expression.derivative(one) for one in names_of(name)]
    evaluator = Evaluator(expression, names_of(name))
    judged = narrow = 0
    for box in boxes_of(name):
        low = np.array([[outwards(ends.lower, -inf) for ends in box.values()]])
        high = np.array([[outwards(ends.upper, inf) for ends in box.values()]])
        exact, jet = range_of(expression, box), evaluator.jet(low, high)
        value = evaluator.value(low, high)
        assert jet.value[0] == value[0] and jet.value[1] == value[1]
        narrow += bool(np.all(np.isfinite(value))) and exact.is_finite
        for point in inside(box):
            at = expression.ball(balls(point))
            if not at.is_finite():
                assert exact == LINE or exact.lower == -inf or exact.upper == inf
                assert np.isinf(value[0][0]) or np.isinf(value[1][0])
                continue
            judged += 1
            assert not (at < _ball(exact.lower) or at > _ball(exact.upper))
            assert not (at < arb(float(value[0][0])) or at > arb(float(value[1][0])))
            for j, slope in enumerate(slopes):
                ends, at = jet.gradient[j], slope.ball(balls(point))
                if at.is_finite() and is_smooth(expression, point):
                    assert not (at < arb(float(ends[0][0])) or at > arb(float(ends[1][0])))
    assert judged > 200
    assert narrow > 10


def _ball(end):
    return fraction_ball(end) if isinstance(end, Fraction) else arb(end)


@every
def test_over_a_point_ranges_and_boxes_are_tight(name):
    expression = SUBJECTS[name]
    evaluator = Evaluator(expression, names_of(name))
    for point in points_of(name):
        at = expression.ball(balls(point))
        if not at.is_finite() or not is_smooth(expression, point) or abs(at) > 1e6:
            continue
        exact = range_of(expression, {one: Range.point(end) for one, end in point.items()})
        assert exact.is_finite and exact.upper - exact.lower <= Fraction(1, 10**25) * (1 + abs(Fraction(exact.upper)))
        row = np.array([[float(end) for end in point.values()]])
        jet = evaluator.jet(row, row)
        for ends in (jet.value, *jet.gradient.values()):
            assert ends[1][0] - ends[0][0] <= 1e-10 * (1 + abs(ends[1][0]))


@every
def test_typesetting(name):
    piece = formula(SUBJECTS[name])
    assert len(latex(piece)) > 2
    assert "".join(ElementTree.fromstring(f"<math>{mathml(piece)}</math>").itertext()).strip()
    assert "x" in latex(piece)


@pytest.mark.parametrize("name", [name for name, one in LANGUAGE.items() if isinstance(one.shape, Kink)])
def test_a_kink_is_on_the_branch_that_its_condition_says(name):
    shape, arguments = LANGUAGE[name].shape, tuple(map(Variable, names_of(name)))
    limits = [(arguments[0], Number(low), Number(high)) for low, high in ((-1, 1), (1, -1))] if name == "sat" else []
    for chosen in (arguments, *limits):
        for point in points_of(name):
            side = shape.condition(*chosen).ball(balls(point))
            if side > 0 or side < 0:
                branch = shape.above(*chosen) if side > 0 else shape.below(*chosen)
                assert call(name, *chosen).ball(balls(point)).overlaps(branch.ball(balls(point)))


def test_over_a_region_that_meets_its_cut_an_angle_is_unbounded_in_value_and_slope():
    angle = parse("atan2(y, x)", frozenset("xy"))
    regions = [(("-1", "1"), ("-2", "-1")), (("0", "1"), ("-1", "1")), (("-1", "1"), ("0.1", "2"))]
    for (y, x), whole in zip(regions, (True, True, False), strict=True):
        box = {"y": Range(*map(Fraction, y)), "x": Range(*map(Fraction, x))}
        jet = Evaluator(angle, ("y", "x")).jet(*(np.array([[float(end[k]) for end in (y, x)]]) for k in (0, 1)))
        assert (range_of(angle, box) == LINE) == whole
        for ends in (jet.value, *jet.gradient.values()):
            assert bool(np.isinf(ends[0][0]) and np.isinf(ends[1][0])) == whole


@pytest.mark.parametrize(
    ("text", "box", "lower", "upper"),
    [
        ("atan(x)", ("-inf", "inf"), -1.5707963267948968, 1.5707963267948968),
        ("asin(x)", ("-1", "0"), -1.5707963267948968, 0),
        ("acos(x)", ("0.5", "1"), 0, 1.0471975511965979),
        ("log10(x)", ("1", "10"), 0, 1),
        ("x**1.852", ("0", "1"), 0, 1),
        ("x**(-0.148)", ("1", "inf"), 0, 1),
        ("tan(x)", ("-0.1", "0"), -0.1003346720854506, 0),
        ("cosh(x)", ("-1", "0.5"), 1, 1.543080634815244),
    ],
)
def test_ranges_of_monotone_functions(text, box, lower, upper):
    ends = Range(*(float(end) if "inf" in end else Fraction(end) for end in box))
    found = range_of(parse(text, frozenset("x")), {"x": ends})
    assert (float(found.lower), float(found.upper)) == pytest.approx((lower, upper), abs=1e-15)
