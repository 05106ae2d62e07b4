"""Whether a plant stays in its domain: tangent fields need unique solutions, inward ones do not."""

from dataclasses import replace

import pytest
from slope_plants import make_plant

from cdobs_cli.bounds.invariance import domain_invariant
from cdobs_cli.exact.numbers import ExactMatrix

UNIT = {"x": ("0", "1")}


@pytest.mark.parametrize(
    ("phi", "status"),
    [
        ("0", "proved"),
        ("-x", "proved"),  # tangent at 0, Lipschitz
        ("x*(1 - x)", "proved"),  # tangent at both sides
        ("1/4 - x", "proved"),  # strictly inwards
        ("1/4 - sqrt(x)", "proved"),  # strictly inwards at 0, where it is not Lipschitz
        ("-sqrt(max(-x, 0))", "undecided"),  # tangent at 0, and x = -(t/2)^2 leaves from there
        ("-sqrt(x)", "undecided"),  # not even defined beyond 0
        ("sqrt(max(x - 1, 0))", "undecided"),  # the same at the upper end
        ("1/100", "refuted"),
    ],
)
def test_a_tangent_side_needs_a_lipschitz_field(phi: str, status: str) -> None:
    claim = domain_invariant(make_plant(("x",), (phi,), box=UNIT))
    assert claim.status == status
    assert claim.kind == "assumption"
    assert not claim.required


def test_a_limit_on_the_only_state_leaves_a_side_without_states() -> None:
    claim = domain_invariant(make_plant(("x",), ("-x",), box={"x": ("-1", "1")}, where=("x",)))
    assert claim.status in ("proved", "undecided")
    assert domain_invariant(make_plant(("x",), ("-1",), box={"x": ("-1", "1")}, where=("x",))).status != "proved"


def test_a_side_is_open_through_another_state() -> None:
    """At x = 0 the speed is y, which takes both signs."""
    assert (
        domain_invariant(make_plant(("x", "y"), ("y", "-y"), box={"x": ("0", "1"), "y": ("-1", "1")})).status
        == "refuted"
    )


def test_the_neighbourhood_reaches_beyond_the_side_in_other_states_too() -> None:
    """Tangent at x = 0, and sqrt(y) is not Lipschitz where that side meets y = 0."""
    box = {"x": ("0", "1"), "y": ("0", "1")}
    assert domain_invariant(make_plant(("x", "y"), ("-x", "-x*sqrt(y)"), box=box)).status == "undecided"
    assert domain_invariant(make_plant(("x", "y"), ("-x", "-y"), box=box)).status == "proved"


@pytest.mark.parametrize(
    ("intensity", "status"),
    [([[1, 0], [0, 0]], "undecided"), ([[0, 0], [0, 1]], "proved"), ([[0, 0], [0, 0]], "proved")],
)
def test_a_white_disturbance_leaves_the_sides_open_that_it_moves_across(intensity, status) -> None:
    """The domain limits x alone, and -x points inwards whatever y is."""
    plant = make_plant(("x", "y"), ("-x", "-y"), box={"x": ("-1", "1")})
    claim = domain_invariant(replace(plant, intensity=ExactMatrix(intensity)))
    assert claim.status == status
    assert ("white disturbance" in claim.statement) == (status == "undecided")
    out = make_plant(("x", "y"), ("x", "-y"), box={"x": ("-1", "1")})
    assert domain_invariant(replace(out, intensity=ExactMatrix(intensity))).status == "refuted"


def test_a_white_disturbance_along_an_affine_limit_does_not_cross_it() -> None:
    plant = make_plant(("x", "y"), ("-x", "-y"), where=("1 - x - y",))
    for intensity, status in (([[1, -1], [-1, 1]], "proved"), ([[1, 1], [1, 1]], "undecided")):
        assert domain_invariant(replace(plant, intensity=ExactMatrix(intensity))).status == status
