"""Characteristics given by points: values between and beyond them, and the slopes that are found."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from cdobs_cli.bounds.ranges import Range, range_of
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.exact.parser import parse
from cdobs_cli.exact.table import MAX_POINTS
from cdobs_cli.spec.model import load

POINTS = [(-2, 1), (0, 5), (1, 4.5), (3, -1)]
TABLE = f"table(x, {[list(point) for point in POINTS]})"


def test_values_are_those_of_linear_interpolation_constant_beyond_the_ends():
    at = np.linspace(-5, 6, 200)
    values = compile_floats([parse(TABLE, frozenset({"x"}))], ["x"], arrays=False)
    wanted = np.interp(at, *zip(*POINTS, strict=True))
    assert np.allclose([values(float(x))[0] for x in at], wanted, atol=1e-13)


@pytest.mark.parametrize(("x", "y"), [*POINTS, (-1, 3), (2, "7/4"), (99, -1), (-99, 1)])
def test_values_are_exact(x, y):
    assert (Exact(TABLE.replace("x", str(x))) - Exact(str(y))).sign() == 0


@pytest.mark.parametrize(
    ("ends", "slopes"),
    [((-1, "1/2"), ("-1/2", 2)), (("1/4", 2), ("-11/4", "-1/2")), ((2, 9), ("-11/4", 0)), ((3, 9), (0, 0))],
)
def test_slopes_over_an_interval_are_those_of_its_pieces(ends, slopes):
    slope = parse(TABLE, frozenset({"x"})).derivative("x")
    found = range_of(slope, {"x": Range(*map(Fraction, ends))})
    assert (found.lower, found.upper) == tuple(map(Fraction, slopes))


def test_a_table_in_a_spec_has_automatic_slopes(tmp_path: Path):
    path = tmp_path / "spring.yaml"
    path.write_text(f"""
spec_version: 1
plant:
  states: [x, v]
  parameters: {{k: 2}}
  dynamics: ["v", "-k*{TABLE.replace("4.5", "9/k")}"]
  output: ["x"]
measurement: {{sampling: {{period: 0.1}}}}
observer: {{family: reachability}}
""")
    assert load(path).plant.slopes.auto == {(1, 0)}


def test_points_are_counted():
    points = [[k, k % 2] for k in range(MAX_POINTS)]
    parse(f"table(x, {points})", frozenset({"x"}))
    with pytest.raises(ValueError, match="at most 32 points"):
        parse(f"table(x, {[*points, [MAX_POINTS, 0]]})", frozenset({"x"}))
