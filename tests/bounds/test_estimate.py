"""How the estimate is kept where the slopes hold, and that a stored way is proved anew."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from slope_plants import make_plant

from cdobs_cli.bounds.estimate import confine, confinement_claim, holds_everywhere
from cdobs_cli.certify.levels import constant_level
from cdobs_cli.design import Confinement
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.plant import Box, Slopes

UNIT = {"x": ("0", "1")}
SQUARE = make_plant(("x",), ("x**2",), lower=[["0"]], upper=[["2"]], box=UNIT)
ROOMY = make_plant(("x",), ("x**2",), lower=[["-0.5"]], upper=[["2.5"]], box=UNIT)
LEVEL = constant_level(ExactMatrix([["1"]])).bounds  # |e| never grows


def start(size: str) -> Box:
    return Box((-Exact(size),), (Exact(size),))


def test_slopes_of_bounded_functions_need_no_domain() -> None:
    assert holds_everywhere(make_plant(("x",), ("sin(x)",), upper=[["1"]], box=UNIT))
    assert not holds_everywhere(make_plant(("x",), ("sin(x)",), upper=[["0.99"]], box=UNIT))
    assert not holds_everywhere(SQUARE)


@pytest.mark.parametrize(
    ("plant", "saturate", "size", "way"),
    [
        (make_plant(("x",), ("tanh(x)",), lower=[["0"]], upper=[["1"]], box=UNIT), "auto", "9", "everywhere"),
        (ROOMY, "auto", "0.2", "margin"),
        (ROOMY, "auto", "0.3", "continuation"),  # slopes up to 2.6 would be met
        (ROOMY, False, "0.2", "margin"),
        (ROOMY, True, "0.2", "continuation"),
        (SQUARE, "auto", "0.001", "continuation"),
        (SQUARE, False, "0.001", "open"),
    ],
)
def test_ways_in_their_order(plant, saturate, size, way) -> None:
    found = confine(plant, saturate, (LEVEL,), start(size))
    assert found.way == way
    assert confinement_claim(plant, found, (LEVEL,)).status == ("undecided" if way == "open" else "proved")


def test_without_typed_errors_a_set_of_them_is_printed() -> None:
    found = confine(ROOMY, False, (LEVEL,), None)
    assert found.way == "margin"
    assert float(found.start[0][1]) == pytest.approx(1 / 16)  # 1/4 would meet 2.5 and a little more
    assert confinement_claim(ROOMY, found, (LEVEL,)).status == "proved"


def test_an_affine_limit_needs_slopes_on_the_whole_box() -> None:
    def product(upper: str):
        box = {"x": ("0", "1"), "y": ("0", "1")}
        return make_plant(
            ("x", "y"),
            ("0", "x*y"),
            lower=[["0", "0"]] * 2,
            upper=[["0", "0"], [upper, "1"]],
            box=box,
            where=("0.5 - y",),
        )

    assert confine(product("1"), "auto", (), None).way == "continuation"
    assert confine(product("0.6"), "auto", (), None).way == "open"  # on the box y reaches 1
    assert confinement_claim(product("0.6"), Confinement("continuation"), ()).status == "undecided"


def test_a_cut_estimate_may_meet_slopes_beyond_the_limits() -> None:
    """0 where x <= 0, and 20 on the box beyond: cut to the box, the estimate meets that."""
    box = {"x": ("-1", "1")}
    kinked = make_plant(("x",), ("20*max(0, x - 0.1)",), box=box, where=("-x",))
    flat = make_plant(("x",), ("min(x, 2) - x",), box=box, where=("-x",))
    assert confinement_claim(kinked, Confinement("cut"), ()).status == "undecided"
    assert confinement_claim(flat, Confinement("cut"), ()).status == "proved"


@pytest.mark.parametrize(
    "stored",
    [
        Confinement("everywhere"),
        Confinement("margin", {"x": "0.21"}, (("-0.22", "0.22"),)),  # the transient is larger
        Confinement("margin", {"x": "0.4"}, (("-0.2", "0.2"),)),  # the slopes do not hold so far
        Confinement("margin", {}, ()),
        Confinement("margin", {"x": "0.21"}, ()),
    ],
)
def test_a_stored_way_is_not_believed(stored: Confinement) -> None:
    assert confinement_claim(ROOMY, stored, (LEVEL,)).status == "undecided"


def test_nothing_is_left_of_a_margin_without_level_sets() -> None:
    assert confinement_claim(ROOMY, Confinement("margin", {"x": "0.21"}, (("-0.2", "0.2"),)), ()).status == "undecided"


def test_secants_of_the_continued_phi_stay_in_the_slope_box() -> None:
    """x in the box, x_hat anywhere: |x_hat| up to 100 times the box."""
    plant = make_plant(
        ("x", "y"), ("x*y", "x**2 - y"), lower=[["0", "-1"], ["-2", "-1"]], upper=[["2", "1"], ["2", "-1"]],
        box={"x": ("-1", "1"), "y": ("0", "2")},
    )  # fmt: skip
    outside, typed = (compile_floats(list(one.phi), plant.states, arrays=True) for one in (plant.continued(), plant))
    random = np.random.default_rng(3)
    x = np.array([random.uniform(-1, 1, 4000), random.uniform(0, 2, 4000)])
    for j in range(2):  # one column at a time: both points differ in x_j only, and the other is inside
        hat = x.copy()
        hat[j] += random.standard_normal(4000) * 10 ** random.uniform(-2, 2, 4000)
        for i in range(2):
            values = (np.broadcast_to(f(*point)[i], 4000) for f, point in ((outside, hat), (typed, x)))
            secants = np.subtract(*values) / (hat[j] - x[j])
            assert float(plant.slopes.lower[i, j]) - 1e-9 <= secants.min()
            assert secants.max() <= float(plant.slopes.upper[i, j]) + 1e-9


def test_the_continued_phi_is_the_typed_one_inside() -> None:
    continued = ROOMY.continued()
    for value in ("0", "0.25", "1"):
        assert continued.phi[0].ball({"x": Exact(value).ball()}).overlaps(Exact(Fraction(value) ** 2).ball())
    assert float(continued.phi[0].ball({"x": Exact("3").ball()})) == pytest.approx(1 + (3 - 1) * 1)


def test_a_domain_of_one_sided_ends_is_clipped_on_that_side() -> None:
    plant = replace(make_plant(("x",), ("max(x, 0)",), lower=[["0"]], upper=[["1"]], box={"x": ("0", None)}))
    assert str(plant.clipped("hat.")["x"]) == "max(hat.x, 0)"


def test_a_nonlinear_output_is_read_before_the_first_correction() -> None:
    """From x_hat(0) = 11 the first secant of x + x^5/1000 is 17, not the 1.005 of the domain: a margin for the time
    after that correction alone proves nothing."""
    linear = make_plant(("x",), ("0",), box={"x": ("-1", "1")})
    output = Slopes(ExactMatrix([["1"]]), ExactMatrix([["1.02"]]))
    plant = replace(linear, h=(parse("x + 0.001*x**5", frozenset({"x"})),), H=output)
    after = (lambda _: constant_level(ExactMatrix([["1"]])).bounds(start("0.001")),)
    near = confine(plant, False, after, start("0.2"))
    assert near.way == "margin" and float(near.margin["x"]) > 0.2
    assert confinement_claim(plant, near, after).status == "proved"
    own = confine(plant, False, after, start("10"))
    assert float(own.start[0][1]) < float(own.margin["x"]) < 1
    forged = Confinement("margin", {"x": "0.002"}, (("-10", "10"),))
    assert confinement_claim(plant, forged, after).status == "undecided"
    assert confinement_claim(linear, forged, after).status == "proved"
