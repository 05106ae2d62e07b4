"""Declared slopes: what is proved, and its nearest twin that must not be."""

from fractions import Fraction

import pytest

from cdobs_cli.certify.slopes import resolve, slope_claims
from cdobs_cli.exact.expression import parse
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.plant import Domain, Input, Interval, Plant, SamplingLaw, Slopes


def interval(ends):
    return Interval(*(None if end is None else Exact(end) for end in ends))


def make_plant(states, phi, lower=None, upper=None, box=None, where=(), inputs=None, auto=()):
    """A plant with only a nonlinearity; slopes default to 0."""
    n = len(states)
    names = frozenset(states) | frozenset(inputs or {})
    zero = [["0"] * n for _ in range(n)]
    upper = upper or zero
    lower = lower or [[str(-Exact(entry).expression) for entry in row] for row in upper]
    return Plant(
        tuple(states),
        tuple(Input(name, interval(ends)) for name, ends in (inputs or {}).items()),
        ExactMatrix(zero),
        tuple(parse(text, names) for text in phi),
        None,
        ExactMatrix([["1"] + ["0"] * (n - 1)]),
        Slopes(ExactMatrix(lower), ExactMatrix(upper), frozenset(auto)),
        SamplingLaw.periodic(Exact("0.1")),
        Domain({name: interval(ends) for name, ends in (box or {}).items()}, tuple(parse(text, names) for text in where)),
    )


def status(plant, identifier="slopes.2.1"):
    return next(claim.status for claim in slope_claims(plant) if claim.id == identifier)


@pytest.mark.parametrize(
    ("phi", "lower", "upper", "tight"),
    [
        ("sin(a)", "-1", "1", "0.999999"),
        ("0.3*sin(a)", "-0.3", "0.3", "0.299999"),
        ("2*cos(3*a - 1)", "-6", "6", "5.9999"),
        ("tanh(a)", "0", "1", "0.99999"),
        ("sat(a)", "0", "1", "0.99999"),
        ("sat(2*a, -0.1, 0.1)", "0", "2", "1.99999"),
        ("abs(a)", "-1", "1", "0.99999"),
    ],
)
def test_suprema_that_belong_to_the_functions_are_proved_exactly_on_the_line(phi, lower, upper, tight):
    def claimed(low, high):
        return make_plant(["a", "b"], ["0", phi], [["0", "0"], [low, "0"]], [["0", "0"], [high, "0"]])

    assert status(claimed(lower, upper)) == "proved"
    assert status(claimed(lower, tight)) == "refuted"
    assert status(claimed(str(Fraction(lower) + Fraction(1, 10**6)), upper)) == "refuted"


def test_an_entry_claimed_zero_is_refuted_where_phi_depends_on_the_state():
    plant = make_plant(["a", "b"], ["0", "sin(a) + 0.01*b"], [["0", "0"], ["-1", "0"]], [["0", "0"], ["1", "0"]])
    assert status(plant, "slopes.2.1") == "proved"
    assert status(plant, "slopes.2.2") == "refuted"


def test_a_refutation_replays_at_its_exact_point():
    plant = make_plant(["a", "b"], ["0", "sin(a)"], upper=[["0", "0"], ["0.99", "0"]])
    (claim,) = slope_claims(plant)
    point = {name: Fraction(value) for name, value in claim.witness.data["point"].items()}
    slope = plant.phi[1].derivative("a").ball({name: Exact(value).ball() for name, value in point.items()})
    assert slope > Exact("0.99").ball() or slope < Exact("-0.99").ball()


def test_automatic_slopes_of_simple_functions_are_the_attained_ones():
    plant = make_plant(["a", "b"], ["0", "tanh(a) + 0.3*sin(b)"], auto=[(1, 0), (1, 1)])
    resolved, found = resolve(plant)
    assert found == {"2.1": ("0", "1"), "2.2": ("-0.3", "0.3")}
    assert not resolved.slopes.auto
    assert resolved.slopes.uncertain == ((1, 0), (1, 1))
