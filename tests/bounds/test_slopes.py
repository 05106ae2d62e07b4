"""Declared slopes: what is proved, and its nearest twin that must not be."""

from fractions import Fraction

import numpy as np
import pytest
from slope_plants import make_plant

from cdobs_cli.bounds.slopes import resolve, slope_claims
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.numbers import Exact


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


BIOREACTOR = ["-u*x1", "0.1*u - (1 + u + 2*0.1*u/x1)*x2 + (2/x1 + 0.1*u/x1**2)*x2**2"]


def bioreactor(below="2.05", second="6.51", auto=()):
    """The Contois bioreactor in normal form, S_in = 0.1; d f2 / d x1 has the true range [-2, 0.893]."""
    return make_plant(
        ["x1", "x2"],
        BIOREACTOR,
        [["-0.5", "0"], [f"-{below}", f"-{second}"]],
        [["-0.05", "0"], ["0.893", second]],
        box={"x1": ("0.02", "1"), "x2": ("0", "1")},
        where=["x1 - x2"],
        inputs={"u": ("0.05", "0.5")},
        auto=auto,
    )


def test_bioreactor_slopes_are_proved_on_its_triangle_and_their_twins_refuted():
    assert status(bioreactor("2.05", "6.51"), "slopes.2.1") == "proved"
    assert status(bioreactor("2.05", "6.51"), "slopes.2.2") == "proved"
    assert status(bioreactor("1.99", "6.49"), "slopes.2.1") == "refuted"
    assert status(bioreactor("1.99", "6.49"), "slopes.2.2") == "refuted"


def test_bioreactor_without_its_triangle_is_refuted():
    plant = bioreactor()
    square = make_plant(
        plant.states, BIOREACTOR, plant.slopes.lower.texts(), plant.slopes.upper.texts(),
        box={"x1": ("0.02", "1"), "x2": ("0", "1")}, inputs={"u": ("0.05", "0.5")},
    )  # fmt: skip
    assert status(square, "slopes.2.1") == "refuted"


def test_an_attained_bound_inside_is_undecided_and_says_what_would_be_proved():
    claim = next(claim for claim in slope_claims(bioreactor("2")) if claim.id == "slopes.2.1")
    assert claim.status == "undecided"
    assert "-2.00" in claim.statement and "would be proved" in claim.statement


def test_automatic_bioreactor_slopes_are_within_one_per_cent_of_the_true_ranges():
    _, found = resolve(bioreactor(auto=[(0, 0), (1, 0), (1, 1)]))
    true = {"1.1": (-0.5, -0.05), "2.1": (-2, 25 / 28), "2.2": (-6.5, 2.95)}
    for entry, (low, high) in true.items():
        room = 0.01 * (high - low)
        assert low - room <= float(found[entry][0]) <= low
        assert high <= float(found[entry][1]) <= high + room


@pytest.mark.parametrize("a", ["2", "2.1"])
def test_van_der_pol_is_exact_on_a_box(a):
    phi = ["0", "0.7*(1 - x1**2)*x2"]
    box = {"x1": (f"-{a}", a), "x2": ("-3", "3.3")}
    corner, end = Fraction("1.4") * Fraction(a) * Fraction("3.3"), Fraction("0.7") * (1 - Fraction(a) ** 2)
    _, found = resolve(make_plant(["x1", "x2"], phi, box=box, auto=[(1, 0), (1, 1)]))
    assert [Fraction(value) for value in found["2.1"]] == [-corner, corner]
    assert [Fraction(value) for value in found["2.2"]] == [end, Fraction("0.7")]
    tight = make_plant(
        ["x1", "x2"], phi, [["0", "0"], [str(-corner), str(end)]], [["0", "0"], [str(corner), "0.7"]], box
    )
    assert status(tight, "slopes.2.1") == status(tight, "slopes.2.2") == "proved"


@pytest.mark.parametrize(
    ("phi", "low", "high"),
    [
        ("sin(a) + 0.5*cos(2*a)", -1.7602, 1.7602),  # periodic: extrema of cos a - sin 2a
        ("a/(1 + a**2)", -0.125, 1),  # rational tails
        ("exp(-a**2)", -0.857764, 0.857764),  # decaying tails
        ("log(1 + a**2)", -1, 1),
        ("min(a, 0.3) + max(a, 0.3)", 1, 1),  # kinks that cancel
        ("max(0, a) + 3*min(0, a)", 1, 3),
        ("a*abs(a)/(1 + abs(a))", 0, 1),
    ],
)
def test_unbounded_domains_by_periods_tails_and_kinks(phi, low, high):
    _, found = resolve(make_plant(["a", "b"], ["0", phi], auto=[(1, 0)]))
    proved = [float(value) for value in found["2.1"]]
    room = 0.01 * (high - low) + 1e-9
    assert low - room <= proved[0] <= low + 1e-4
    assert high - 1e-4 <= proved[1] <= high + room


@pytest.mark.parametrize(
    ("phi", "box", "low", "high"),
    [
        ("sin(1.3*atan(10*a))", {"a": ("-5", "5")}, -0.1267, 13),  # the tyre formula
        ("sin(1.3*atan(10*a))", {"a": ("0.1", "5")}, -0.1267, 3.3949),
        ("a**1.852", {"a": ("0", "2")}, 0, 3.3429),  # friction in pipes
        ("a*abs(a)**0.852", {"a": ("-1", "2")}, 0, 3.3429),
        ("0.3*a**1.37", {"a": ("0.1", "5")}, 0.1754, 0.7456),
        ("log10(a) + asin(a/2)", {"a": ("0.1", "1")}, 1.0116, 4.8436),
        ("atan2(a, b)", {"a": ("-1", "2"), "b": ("1", "2")}, 0.2, 1),
        ("monod(a, 0.5)", {"a": ("0", None)}, 0, 2),
    ],
)
def test_automatic_slopes_hold_every_sample_and_little_more(phi, box, low, high):
    plant = make_plant(["a", "b"], ["0", phi], box=box, auto=[(1, 0)])
    (ends,) = resolve(plant)[1].values()
    proved = [float(value) for value in ends]
    a = np.linspace(float(box["a"][0]), float(box["a"][1] or 1e3), 20_001)
    b = np.linspace(*map(float, box.get("b", ("1", "1"))), 11)
    with np.errstate(all="ignore"):
        (values,) = compile_floats([plant.phi[1].derivative("a")], ["a", "b"], arrays=True)(a[:, None], b)
    values = values[np.isfinite(values)]
    assert proved[0] <= values.min() + 1e-12 and values.max() - 1e-12 <= proved[1]
    room = 0.003 * (high - low)
    assert proved == pytest.approx([low, high], abs=room)


def test_an_unbounded_slope_has_no_automatic_bound():
    resolved, found = resolve(make_plant(["a", "b"], ["0", "a**2 + sin(b)"], auto=[(1, 0), (1, 1)]))
    assert found == {"2.2": ("-1", "1")}
    assert resolved.slopes.auto == {(1, 0)}


@pytest.mark.parametrize(
    ("phi", "box", "expected"),
    [
        ("a/a", {}, "refuted"),
        ("1/a", {"a": ("-1", "1")}, "refuted"),
        ("1/a", {"a": ("0", "1")}, "refuted"),
        ("1/a", {"a": ("0.1", "1")}, "proved"),
        ("log(a)", {"a": ("-0.1", "1")}, "refuted"),
        ("sqrt(a - 0.5)", {"a": ("0.5", "1")}, "proved"),
        ("sqrt(a - 0.5)", {"a": ("0.4", "1")}, "refuted"),
        ("1/(a**2 - 2)", {"a": ("1", "2")}, "refuted"),
        ("tan(a)", {"a": ("-1.57", "1.57")}, "proved"),
        ("tan(a)", {"a": ("-1.58", "1.58")}, "refuted"),
        ("a**1.37", {"a": ("0", "1")}, "proved"),
        ("a**1.37", {"a": ("-0.1", "1")}, "refuted"),
        ("a**(-0.37)", {"a": ("0", "1")}, "refuted"),
        ("asin(a)", {"a": ("-1", "1")}, "proved"),
        ("acos(a)", {"a": ("-1", "1.001")}, "refuted"),
        ("log10(a)", {"a": ("0.1", "1")}, "proved"),
        ("ln(a)", {"a": ("0", "1")}, "refuted"),
        ("atan2(a, b)", {"a": ("-1", "1"), "b": ("0.1", "1")}, "proved"),
        ("atan2(a, b)", {"a": ("0.1", "1"), "b": ("-1", "1")}, "proved"),
        ("atan2(a, b)", {"a": ("-1", "1"), "b": ("-1", "1")}, "refuted"),
        ("atan2(a, b)", {"a": ("-2", "1"), "b": ("-2", "-1")}, "refuted"),
        ("atan2(a, b)", {}, "refuted"),
    ],
)
def test_definedness_is_judged_on_the_typed_expression(phi, box, expected):
    plant = make_plant(["a", "b"], ["0", phi], box=box)
    assert status(plant, "defined") == expected
    if expected == "refuted":
        assert status(plant, "slopes.2.1") == "refuted"


def test_the_domain_of_an_epidemic_is_invariant_and_that_of_a_spring_is_not():
    epidemic = make_plant(
        ["S", "I"], ["-0.5*S*I", "0.5*S*I - 0.2*I"], box={"S": ("0", "1"), "I": ("0", "1")}, where=["1 - S - I"]
    )
    assert status(epidemic, "domain_invariant") == "proved"
    spring = make_plant(["x", "v"], ["v", "-x"], box={"x": ("-1", "1"), "v": ("-1", "1")})
    assert status(spring, "domain_invariant") == "refuted"


def test_nothing_is_proved_over_an_empty_domain():
    empty = make_plant(
        ["a", "b"],
        ["0", "a**2"],
        upper=[["0", "0"], ["1", "0"]],
        box={"a": ("0", "1"), "b": ("0", "1")},
        where=["a - 2"],
    )
    assert status(empty) == "undecided"


def test_a_domain_that_is_a_small_part_of_its_box_is_met():
    where = ["a + b + c + d - 3.9"]
    box = dict.fromkeys("abcd", ("0", "1"))
    upper = [["0"] * 4, ["1.99", "0", "0", "0"], ["0"] * 4, ["0"] * 4]
    assert status(make_plant("abcd", ["0", "a**2", "0", "0"], upper=upper, box=box, where=where)) == "refuted"
    lower = [["0"] * 4, ["1.79", "0", "0", "0"], ["0"] * 4, ["0"] * 4]
    upper[1][0] = "2"
    assert status(make_plant("abcd", ["0", "a**2", "0", "0"], lower, upper, box=box, where=where)) == "proved"
