"""What is proved on the pieces is proved of the function: each piece has the function's values on its part."""

from fractions import Fraction

import pytest

from cdobs_cli.bounds.reduction import pieces
from cdobs_cli.bounds.region import Region
from cdobs_cli.bounds.slopes import automatic
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.exact.parser import parse
from cdobs_cli.plant import Box, Interval

NAMES = ("x", "y")


def region(low, high):
    return Region.made({name: Interval(Exact(low), Exact(high)) for name in NAMES}, NAMES, ())


@pytest.mark.parametrize(
    "text",
    [
        "min(x, 1 - 2*x)",
        "max(x, 1 - 2*x)",
        "min(2*x - 1, -x)",
        "max(3*x, y)",
        "min(x, y) + max(x, 2*y)",
        "abs(x - 0.3)",
        "min(x, 0.25)",
    ],
)
def test_each_side_of_a_kink_has_its_own_branch(text):
    function = parse(text, frozenset(NAMES))
    whole = region("-2", "2")
    parts = list(pieces(function, whole))
    assert len(parts) > 1
    covered = 0
    for i in range(-16, 17):
        for j in range(-16, 17):
            point = {"x": fraction_ball(Fraction(i, 8)), "y": fraction_ball(Fraction(j, 8))}
            value = function.ball(point)
            inside = [
                part
                for part in parts
                if all(
                    part.region.box[name].lower <= Fraction(k, 8) <= part.region.box[name].upper
                    for name, k in (("x", i), ("y", j))
                )
                and all(w.ball(point) >= 0 for w in part.region.where)
            ]
            covered += bool(inside)
            for part in inside:
                for form in part.forms:
                    assert abs(form.ball(point) - value) < 1e-20, (text, i, j, str(form))
    assert covered == 33 * 33


@pytest.mark.parametrize(
    ("text", "low", "high"),
    [
        ("min(x, 1 - 2*x)*x", -7, 2 / 3),  # slope 2 x up to x = 1/3, then 1 - 4 x
        ("max(x, 1 - 2*x)*x", -1 / 3, 9),
        ("min(x, 0.5) - 3*max(x, 0.5)", -3, 1),
    ],
)
def test_slopes_across_a_kink(text, low, high):
    """The extremes of the slope over [-2, 2], reached at an end or at the kink."""
    slope = parse(text, frozenset(NAMES)).derivative("x")
    found = automatic(slope, region("-2", "2"))
    assert found is not None
    reached = [
        float(
            slope.ball({"x": fraction_ball(Fraction(k, 64) + Fraction(1, 1000)), "y": fraction_ball(Fraction(0))}).mid()
        )
        for k in range(-128, 127)
    ]
    assert float(found[0]) <= min(reached) and float(found[1]) >= max(reached)
    assert low - 0.05 <= float(found[0]) <= low + 0.05 + abs(low) * 0.02
    assert high - 0.05 - abs(high) * 0.02 <= float(found[1]) <= high + 0.05


def test_a_region_over_the_names_of_an_expression_keeps_what_is_said_of_them_alone():
    names = ("x", "y", "u")
    where = (parse("1 - x - y", frozenset(names)), parse("2 - x - u", frozenset(names)))
    whole = Region.made({"x": Interval(Exact(0), Exact(1)), "u": Interval(None, Exact(3))}, names, where)
    part = whole.over(parse("x*y", frozenset(names)))
    assert part.names == ("x", "y") and part.where == where[:1] and set(part.ends) == {"x"}
    beside = part.beside(["d.0"], Box((Exact(-1),), (Exact("1/2"),)))
    assert beside.names == ("x", "y", "d.0") and beside.where == where[:1]
    assert beside.holds({"x": Fraction(1), "y": Fraction(0), "d.0": Fraction(1, 2)})
    assert not beside.holds({"x": Fraction(1), "y": Fraction(0), "d.0": Fraction(51, 100)})
    assert not beside.holds({"x": Fraction(1), "y": Fraction(1, 2), "d.0": Fraction(0)})
