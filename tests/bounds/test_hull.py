"""Functions that follow one another: their curve's hull in a parallelogram, exactly the same slopes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from slope_plants import make_plant

from cdobs_cli.bounds.hull import Shared, within_parallelograms
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.parser import parse

PLANT = make_plant(["v", "w"], ["0", "0"], box={"v": (10, 30), "w": (-1, 1)})


def shared(*texts: str) -> list[Shared]:
    functions = [parse(text, {"v", "w", "u"}) for text in texts]
    return [Shared(one, (((0, k), Fraction(1)), ((1, k), Fraction(-2)))) for k, one in enumerate(functions)]


def entries(functions: list[Shared], at: dict[str, float]) -> dict[tuple[int, int], float]:
    names = sorted(at)
    total: dict[tuple[int, int], float] = {}
    for one in functions:
        (value,) = compile_floats([one.function], names, arrays=False)(*(at[name] for name in names))
        for entry, weight in one.weights:
            total[entry] = total.get(entry, 0.0) + float(weight) * value
    return total


def widths(functions: list[Shared]) -> list[float]:
    v, w = np.meshgrid(np.linspace(10, 30, 201), np.linspace(-1, 1, 21))
    values = (compile_floats([one.function], ["v", "w"], arrays=True)(v, w)[0] for one in functions)
    return [float(np.ptp(value)) for value in values]


@pytest.mark.parametrize(
    "texts",
    [
        ("1/v", "1/v**2"),
        ("1/v", "1/v**2", "1/v**3"),
        ("exp(-100/v)", "exp(-100/v)/v**2", "w"),
        ("v*w", "w", "v*w + w**3*v/100"),
    ],
)
def test_the_slopes_are_the_same_and_the_ranges_smaller(texts: tuple[str, ...]) -> None:
    before = shared(*texts)
    after = within_parallelograms(before, PLANT)
    assert after != before and len(after) == len(before)
    rng = np.random.default_rng(3)
    for v, w in zip(rng.uniform(10, 30, 50), rng.uniform(-1, 1, 50), strict=True):
        at = {"v": float(v), "w": float(w)}
        told, typed = entries(after, at), entries(before, at)
        assert told.keys() >= typed.keys()
        assert all(value == pytest.approx(typed.get(entry, 0.0), rel=1e-9, abs=1e-12) for entry, value in told.items())
    assert np.prod(widths(after)) <= 0.5 * np.prod(widths(before))


@pytest.mark.parametrize("texts", [("v", "w"), ("v*w", "w**2"), ("u", "u**2"), ("w", "w**2")])
def test_functions_that_do_not_follow_stay(texts: tuple[str, ...]) -> None:
    """Of other variables, of a range that nobody declared, or even where the other is odd."""
    assert within_parallelograms(shared(*texts), PLANT) == shared(*texts)


def test_the_range_of_an_input_counts() -> None:
    plant = make_plant(["v"], ["0"], inputs={"u": (1, 2)})
    after = within_parallelograms(shared("u", "u**2"), plant)
    assert str(after[1].function).count("u") == 2
    assert after[0].weights != shared("u", "u**2")[0].weights
