"""Automatic bounds of random nonlinearities: no sampled point violates what was proved."""

import random
from fractions import Fraction

import numpy as np

import cdobs_cli.bounds.bounded as bounds
from cdobs_cli.bounds.bounded import bounded
from cdobs_cli.bounds.region import Region
from cdobs_cli.bounds.slopes import automatic
from cdobs_cli.bounds.supremum import ROUND, _split_up
from cdobs_cli.exact.budget import READING, budget
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.expression import Number, Variable, call, power
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.exact.parser import parse
from cdobs_cli.plant import Interval

NAMES = ("x", "y", "u")
BOX = (("x", "-1", "2"), ("y", "-1.3", "0.7"), ("u", "0.1", "0.9"))
TRIANGLE = parse("x - y", frozenset(NAMES))


def smooth(source, depth):
    """A random expression that is defined for all values."""
    if depth == 0:
        return source.choice([*(Variable(name) for name in NAMES), Number(Fraction(source.randint(-20, 20), 10))])
    a = smooth(source, depth - 1)
    match source.randint(0, 7):
        case 0 | 1:
            return a + smooth(source, depth - 1)
        case 2 | 3:
            return a * smooth(source, depth - 1)
        case 4:
            return a / (Number(Fraction(3, 2)) + power(smooth(source, depth - 1), Fraction(2)))
        case 5:
            return call(source.choice(["sin", "cos", "tanh"]), a)
        case 6:
            return call(source.choice(["abs", "sin"]), a)
        case _:
            return call(source.choice(["min", "max"]), a, smooth(source, depth - 1))


def sampled_violations(seed, expressions, points):
    """Bounds violated beyond any doubt at a sampled point; how many bounds were proved; their looseness."""
    source, draws = random.Random(seed), np.random.default_rng(seed)
    violations, looseness = [], []
    for _ in range(expressions):
        slope = smooth(source, source.randint(2, 4)).derivative("x")
        ends = {
            name: Interval(Exact(low), Exact(high))
            for name, low, high in (("x", "-1", "2"), ("y", "-1.3", "0.7"), ("u", "0.1", "0.9"))
        }
        region = Region.made(ends, NAMES, (TRIANGLE,))
        found = automatic(slope, region)
        if found is None:
            continue
        low, high = float(found[0]), float(found[1])
        sample = draws.uniform([-1, -1.3, 0.1], [2, 0.7, 0.9], (points, 3))
        sample = sample[sample[:, 0] >= sample[:, 1]]
        (values,) = compile_floats([slope], NAMES, arrays=True)(*sample.T)
        values = np.broadcast_to(values, sample.shape[:1])
        # Points that floats put outside are judged again in balls.
        for k in np.flatnonzero((values > high) | (values < low))[:50]:
            ball = slope.ball(
                {name: fraction_ball(Fraction(float(at))) for name, at in zip(NAMES, sample[k], strict=True)}
            )
            if ball > Exact(found[1]).ball() or ball < Exact(found[0]).ball():
                violations.append((str(slope), sample[k]))
        seen = float(values.max() - values.min())
        looseness.append((high - low) / seen - 1 if seen > 1e-9 else 0.0)
    return violations, looseness


def test_no_sampled_point_violates_an_automatic_bound():
    violations, looseness = sampled_violations(seed=11, expressions=20, points=10_000)
    assert not violations
    assert len(looseness) >= 15
    # Samples miss the ends a little; bounds are within a few hundredths of what they meet.
    assert np.median(looseness) < 0.03


def test_a_bound_just_below_a_sampled_value_is_never_proved():
    source, draws = random.Random(4), np.random.default_rng(4)
    ends = {name: Interval(Exact("-1"), Exact("1")) for name in NAMES}
    region = Region.made(ends, NAMES, ())
    judged = 0
    for _ in range(25):
        function = smooth(source, 3)
        sample = draws.uniform(-1, 1, (200, 3))
        (values,) = compile_floats([function], NAMES, arrays=True)(*sample.T)
        best = float(np.max(values))
        if np.isfinite(best):
            judged += 1
            limit = Exact(str(Fraction(best) - Fraction(1, 10**6)))
            assert bounded(function, region, limit, 200_000).status != "proved"
    assert judged > 15


def test_parts_of_a_box_fill_it_and_are_as_many_as_a_round_is_worth():
    low, high = np.array([[-1.0, 0.0], [2.0, 5.0]]), np.array([[1.0, 3.0], [2.5, 5.5]])
    parts, parents = _split_up((low, high), np.array([[4.0, 1.0], [0.0, 2.0]]))
    assert ROUND / 2 < len(parents) <= ROUND
    for box in range(2):
        mine = parents == box
        assert np.all(parts[0][mine] >= low[box]) and np.all(parts[1][mine] <= high[box])
        areas = np.prod(parts[1][mine] - parts[0][mine], axis=1)
        assert np.isclose(areas.sum(), np.prod(high[box] - low[box]))
        # Halves of one box, none of which lies in another.
        points = np.random.default_rng(1).uniform(low[box], high[box], (200, 2))[:, None]
        held = np.all((parts[0][mine] <= points) & (points <= parts[1][mine]), axis=2)
        assert np.all(held.sum(axis=1) == 1)
    assert np.all(parts[1][parents == 1, 0] - parts[0][parents == 1, 0] == 0.5)  # no slope, no cut


def test_a_box_as_small_as_floats_allow_is_not_split():
    low, high = np.array([[1.0]]), np.array([[np.nextafter(1.0, 2.0)]])
    assert _split_up((low, high), np.array([[1.0]]))[0] is None


def test_what_was_bounded_is_remembered_for_its_region_and_limit_alone_and_forgotten_before_the_next_spec():
    ends = {"x": Interval(Exact("0"), Exact("1"))}
    region = Region.made(ends, ("x",), ())
    wider = Region.made({"x": Interval(Exact("0"), Exact("2"))}, ("x",), ())
    square = parse("x*x", frozenset(("x",)))
    assert bounded(square, region, Exact("1.5"), 10**6).status == "proved"
    before = bounds._bounded.cache_info().hits
    assert bounded(square, region, Exact("1.5"), 10**6).status == "proved"
    assert bounds._bounded.cache_info().hits == before + 1
    assert bounded(square, wider, Exact("1.5"), 10**6).status == "undecided"
    assert bounded(square, region, Exact("0.5"), 10**6).status == "undecided"
    with budget(READING):
        assert bounds._bounded.cache_info().currsize == 0
