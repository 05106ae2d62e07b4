"""Typed dynamics made a plant, and back."""

import numpy as np
import pytest

from cdobs_cli.bounds.slopes import resolve, slope_claims
from cdobs_cli.coordinates import derive
from cdobs_cli.errors import SpecError
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.exact.rational import is_zero
from cdobs_cli.exact.solve import solve
from cdobs_cli.plant import Box, CoordinateMap, Domain, Input, Interval, Slopes, TypedDynamics
from cdobs_cli.run import SimulationPlan
from cdobs_cli.sampling import SamplingLaw


def typed(
    states, f, h, coordinates=None, box=None, where=(), inputs=None, names=None, phi=None, disturbance=None, **printed
):
    inputs = inputs or {}
    old, new = frozenset(states) | frozenset(inputs), frozenset(names or states) | frozenset(inputs)
    if isinstance(coordinates, tuple):
        there, back = coordinates
        coordinates = CoordinateMap(
            names, tuple(parse(text, old) for text in there), tuple(parse(text, new) for text in back)
        )
    return TypedDynamics(
        tuple(states),
        tuple(Input(name, Interval(Exact(low), Exact(high))) for name, (low, high) in inputs.items()),
        tuple(parse(text, old) for text in f),
        tuple(parse(text, old) for text in h),
        SamplingLaw.periodic(Exact("0.1")),
        coordinates,
        tuple(names or states),
        phi=tuple(parse(text, new) for text in phi) if phi else None,
        domain=Domain(
            {name: Interval(Exact(low), Exact(high)) for name, (low, high) in (box or {}).items()},
            tuple(parse(text, old) for text in where),
        ),
        disturbance=disturbance,
        **printed,
    )


CONTOIS = ["contois(S, X, 1)*X - D*X", "-contois(S, X, 1)*X - D*(S - 0.1)"]
DERIVED = ["-D*x1", "0.1*D - (1 + D + 2*0.1*D/x1)*x2 + (2/x1 + 0.1*D/x1**2)*x2**2"]
MISPRINT = ["-D*x1", "0.1*D - (1 + D + 2*0.1*D/x1)*x2 + ((2 - D)/x1 + 0.1*D/x1**2)*x2**2"]


def bioreactor(coordinates="lie", phi=None):
    return typed(
        ["X", "S"], CONTOIS, ["X"], coordinates,
        {"X": ("0.02", "1"), "S": ("0.004", "1")}, ["0.1 - X - S"], {"D": ("0.05", "0.5")}, ("x1", "x2"), phi,
    )  # fmt: skip


def statuses(coordinates, claims):
    return {claim.id: claim.status for claim in coordinates.premises(claims)}


def test_lie_coordinates_of_the_bioreactor_are_the_papers():
    plant, coordinates = derive(bioreactor())
    names = frozenset({"X", "S", "D", "x1", "x2"})
    assert is_zero(coordinates.map[1] - parse("S*X/(X + S)", names))
    assert is_zero(coordinates.inverse[1] - parse("x1*x2/(x1 - x2)", names))
    assert plant.is_canonical or plant.A.texts() == [["0", "1"], ["0", "0"]]
    assert plant.C.texts() == [["1", "0"]]
    for phi, printed in zip(plant.phi, DERIVED, strict=True):
        assert is_zero(phi - parse(printed, names))


def test_the_printed_bioreactor_is_found_wrong_and_its_correction_right():
    # Andrieu2014 prints (2 - u)/x1 where 2/x1 is derived.
    for phi, expected in ((DERIVED, "proved"), (MISPRINT, "refuted")):
        plant, coordinates = derive(bioreactor(phi=phi))
        found = {claim.id: claim.status for claim in coordinates.printed()}
        assert found == {"printed.phi.1": "proved", "printed.phi.2": expected}
        assert is_zero(plant.phi[1] - parse(DERIVED[1], frozenset({"x1", "x2", "D"})))


def test_the_change_of_coordinates_is_proved_and_a_wrong_inverse_refutes_the_slopes():
    plant, coordinates = derive(bioreactor())
    resolved, _ = resolve(plant)
    found = statuses(coordinates, slope_claims(resolved))
    assert found["coordinates.inverse"] == found["coordinates.diffeomorphism"] == found["defined"] == "proved"
    assert found["slopes.1.1"] == found["slopes.2.1"] == found["slopes.2.2"] == "proved"

    plant, coordinates = derive(bioreactor((["X", "S*X/(X + S)"], ["x1", "x1*x2/(x1 + x2)"])))
    zero = slope_claims(resolve(plant)[0])
    found = statuses(coordinates, zero)
    assert found["coordinates.inverse"] == "refuted"
    assert found["slopes.2.1"] == "refuted"


def test_the_image_of_the_domain_holds_the_image_of_every_state():
    plant, coordinates = derive(bioreactor())
    random = np.random.default_rng(1)
    x = random.uniform([0.02, 0.004], [0.1, 0.1], (20000, 2))
    z = coordinates.new_values(x[x.sum(axis=1) <= 0.1])
    for j, name in enumerate(plant.states):
        interval = plant.domain.box[name]
        assert np.all(z[:, j] >= float(interval.lower)) and np.all(z[:, j] <= float(interval.upper))
    assert plant.domain.where
    for w in plant.domain.where:
        values = [
            float(w.ball({name: Exact(str(value)).ball() for name, value in zip(plant.states, row, strict=True)}).mid())
            for row in z[:200]
        ]
        assert min(values) >= 0
    assert np.allclose(coordinates.original_values(z), x[x.sum(axis=1) <= 0.1])


def test_the_flow_in_new_coordinates_is_the_typed_flow():
    plant, coordinates = derive(bioreactor())
    x, D, h = np.array([0.05, 0.03]), 0.2, 1e-6
    contois = x[1] / (x[0] + x[1])
    f = np.array([contois * x[0] - D * x[0], -contois * x[0] - D * (x[1] - 0.1)])
    slope = (coordinates.new_values(x + h * f) - coordinates.new_values(x - h * f)) / (2 * h)
    z = coordinates.new_values(x)
    env = {name: Exact(repr(float(value))).ball() for name, value in zip(plant.states, z, strict=True)} | {
        "D": Exact("0.2").ball()
    }
    assert np.allclose([float(row.ball(env).mid()) for row in plant.right_hand_side()], slope, atol=1e-8)


def test_a_flexible_joint_is_a_chain_of_integrators():
    joint = typed(
        ["q", "w", "r", "s"], ["w", "-10*sin(q) + 5*(r - q)", "s", "-5*(r - q) - s + u"], ["q"], "lie",
        inputs={"u": ("-1", "1")}, names=("x1", "x2", "x3", "x4"),
    )  # fmt: skip
    plant, coordinates = derive(joint)
    assert [row[1:] for row in plant.A.texts()] == [["1", "0", "0"], ["0", "1", "0"], ["0", "0", "1"], ["0", "0", "0"]]
    assert [str(phi) for phi in plant.phi[:3]] == ["0", "0", "0"]
    assert coordinates.inverse_claim().status == "proved"
    assert coordinates.diffeomorphism().margin == "25"


def test_simulations_typed_in_the_states_move_to_the_coordinates():
    _, coordinates = derive(bioreactor())
    plan = SimulationPlan(
        Exact("1"), (Exact("0.05"), Exact("0.03")), Box((Exact("0.04"), Exact("0.02")), (Exact("0.05"), Exact("0.03")))
    )
    moved = coordinates.plan(plan)
    assert [value.rational for value in moved.initial_state] == [Exact("1/20").rational, Exact("3/160").rational]
    for low, value, high in zip(moved.initial_box.lower, moved.initial_state, moved.initial_box.upper, strict=True):
        assert float(low) <= float(value) <= float(high)


def test_disturbances_are_pushed_through_the_map():
    d = Box((Exact("-1"), Exact("-1")), (Exact("1"), Exact("1")))
    plant, _ = derive(
        typed(
            ["a", "b"],
            ["b", "-a"],
            ["a + b"],
            (["a + b", "a - b"], ["(x1 + x2)/2", "(x1 - x2)/2"]),
            names=("x1", "x2"),
            disturbance=d,
        )
    )
    assert [float(end) for end in plant.disturbance.upper] == [2, 2]
    assert plant.A.texts() == [["0", "-1"], ["1", "0"]]


def test_dynamics_alone_are_split_into_linear_terms_and_the_rest():
    plant, coordinates = derive(typed(["x", "v"], ["v", "x - x**3 - 0.2*v + u"], ["x"], inputs={"u": ("-1", "1")}))
    assert coordinates is None
    assert plant.A.texts() == [["0", "1"], ["1", "-0.2"]]
    assert plant.slopes.auto == {(1, 0)}
    assert is_zero(plant.phi[1] - parse("u - x**3", frozenset({"x", "u"})))


def test_splitting_keeps_what_is_undefined_in_phi():
    plant, _ = derive(typed(["x", "v"], ["v", "x/x - x"], ["x"]))
    assert "x / x" in str(plant.phi[1])
    assert plant.A.texts()[1] == ["-1", "0"]


@pytest.mark.parametrize(
    ("plant", "field"),
    [
        (typed(["x", "v"], ["v", "-x"], ["x**2"], (["x", "v"], ["x1", "x2"]), names=("x1", "x2")), "plant.output[0]"),
        (
            typed(["x", "v"], ["v", "-x"], ["x + u"], "lie", inputs={"u": ("1", "2")}, names=("x1", "x2")),
            "plant.output[0]",
        ),
        (typed(["x", "v"], ["v", "-x"], ["sin(x)"], "lie", names=("x1", "x2")), "plant.coordinates"),
        (typed(["x", "v"], ["v", "-x"], ["0*x"], "lie", names=("x1", "x2")), "plant.coordinates"),
        (typed(["x", "v"], ["v", "-x"], ["x", "v"], "lie", names=("x1", "x2")), "plant.coordinates"),
        (
            typed(["x", "v"], ["v", "-x + 1/u"], ["x"], "lie", inputs={"u": ("1", "2")}, names=("x1", "x2")),
            "plant.coordinates",
        ),
        (
            typed(["x", "v"], ["v", "-sin(x)"], ["x"], phi=["0", "sin(x)"], A=ExactMatrix([["0", "1"], ["0", "0"]])),
            "plant.phi[1]",
        ),
    ],
)
def test_what_cannot_be_transformed_is_said_at_its_field(plant, field):
    with pytest.raises(SpecError) as error:
        derive(plant)
    assert [problem.path for problem in error.value.problems] == [field]


def test_printed_slopes_are_claims_on_the_derived_phi():
    slopes = Slopes(ExactMatrix([["0", "0"], ["-1", "0"]]), ExactMatrix([["0", "0"], ["1", "0"]]))
    plant, _ = derive(typed(["x", "v"], ["v", "-sin(x)"], ["x"], slopes=slopes))
    assert [claim.status for claim in slope_claims(plant)] == ["proved"]


def test_elimination_solves_triangular_and_linear_maps_and_admits_when_it_cannot():
    names = frozenset({"a", "b", "z1", "z2"})

    def solved(equations, nonnegative=()):
        return solve([parse(text, names) for text in equations], ["a", "b"], nonnegative)

    found = solved(["z1 - (a + b)", "z2 - (a - b)"])
    assert is_zero(found["a"] - parse("(z1 + z2)/2", names))
    found = solved(["z1 - log(a)", "z2 - exp(2*b)*a"])
    assert is_zero(found["b"] - parse("log(z2/exp(z1))/2", names))
    found = solved(["z1 - a**2", "z2 - sqrt(b)*a"], ["a", "b"])
    assert is_zero(found["b"] - parse("z2**2/z1", names))
    assert solved(["z1 - a**2", "z2 - b"]) is None
    assert solved(["z1 - sin(a)", "z2 - b"]) is None
    assert solved(["z1 - a", "z2 - a"]) is None
