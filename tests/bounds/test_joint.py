"""Slopes that several entries share: the fewest functions, exactly, and proofs that use them."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from cdobs_cli.bounds.joint import joint_slopes
from cdobs_cli.bounds.slopes import resolve, slope_claims, with_found
from cdobs_cli.certify.falsify import refute
from cdobs_cli.certify.methods.rung import GENERAL
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Plant, Quantity
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.spec.model import Spec, load

LORENZ = """
spec_version: 1
plant:
  states: [x, y, z]
  parameters: {s: 10, r: 28, b: "8/3"}
  dynamics: ["s*(y - x)", "r*x - y - x*z", "x*y - b*z"]
  output: ["x"]
  domain: {x: [-20, 20], y: [-28, 28], z: [0, 50]}
measurement: {sampling: {max_period: 0.02}}
observer: {family: lpv_zoh, objective: max_period}
"""
DIGESTER = """
spec_version: 1
plant:
  states: [X1, S1, X2, S2]
  inputs: {D: {range: [0.2, 0.4]}}
  parameters: {al: 0.5, k1: 42.14, k2: 116.5, k3: 268, m1: 1.2, K1: 7.1, m2: 0.74, K2: 9.28, KI: 256, S1in: 10, S2in:
  80}
  dynamics:
    - "(m1*S1/(K1+S1) - al*D)*X1"
    - "D*(S1in - S1) - k1*m1*S1/(K1+S1)*X1"
    - "(m2*S2/(K2+S2+S2**2/KI) - al*D)*X2"
    - "D*(S2in - S2) + k2*m1*S1/(K1+S1)*X1 - k3*m2*S2/(K2+S2+S2**2/KI)*X2"
  output: ["S1", "S2"]
  domain: {X1: [0.2, 0.8], S1: [0.5, 8], X2: [0.3, 1.2], S2: [2, 40]}
measurement: {sampling: {max_period: 1}}
observer: {family: lpv_zoh}
"""
VEHICLE = """
spec_version: 1
plant:
  states: [beta, r]
  inputs: {speed: {range: [10, 30]}}
  dynamics: ["-160*beta/speed - r + 8*r/speed**2", "10*beta - 170*r/speed"]
  output: ["r"]
  domain: {beta: [-0.1, 0.1], r: [-1, 1]}
measurement: {sampling: {period: 0.05}}
observer: {family: reachability}
"""


def made(text: str, tmp_path: Path) -> Spec:
    path = tmp_path / "spec.yaml"
    path.write_text(text)
    return load(path)


@pytest.mark.parametrize(("text", "entries", "functions"), [(LORENZ, 4, 3), (DIGESTER, 10, 5), (VEHICLE, 3, 2)])
def test_the_fewest_functions(text: str, entries: int, functions: int, tmp_path: Path) -> None:
    """Lorenz: x, y, z; the digester: two growth rates, what they change by, the dilution; a vehicle: 1/v, 1/v^2."""
    plant = made(text, tmp_path).plant
    joint = joint_slopes(plant)
    assert joint is not None and len(plant.slopes.auto) == entries and len(joint.functions) == functions


def jacobian(plant: Plant, at: dict[str, float]) -> np.ndarray:
    derivatives = [[plant.phi[i].derivative(name) for name in plant.states] for i in range(plant.n)]
    return np.array(
        [[float(d.ball({k: Exact(str(v)).ball() for k, v in at.items()}).mid()) for d in row] for row in derivatives]
    )


@pytest.mark.parametrize("text", [LORENZ, DIGESTER, VEHICLE])
def test_the_functions_make_the_jacobian_and_their_bounds_hold(text: str, tmp_path: Path) -> None:
    plant, found = resolve(made(text, tmp_path).plant)
    assert with_found(made(text, tmp_path).plant, found) == plant
    assert {claim.status for claim in slope_claims(plant) if claim.required} == {"proved"}
    view = PlantView.floats(plant, {})
    random = np.random.default_rng(3)
    ends = {name: (float(box.lower or 0), float(box.upper or 0)) for name, box in plant.domain.box.items()}
    ends |= {one.name: (float(one.range.lower or 0), float(one.range.upper or 0)) for one in plant.inputs if one.range}
    for _ in range(50):
        at = {name: round(float(random.uniform(*end)), 6) for name, end in ends.items()}
        values = [
            float(rho.function.ball({k: Exact(str(v)).ball() for k, v in at.items()}).mid())
            for rho in plant.slopes.joint
        ]
        assert all(float(rho.lower) <= v <= float(rho.upper) for rho, v in zip(plant.slopes.joint, values, strict=True))
        slopes = view.flow(values) - plant.A.floats
        assert slopes == pytest.approx(jacobian(plant, at), rel=1e-9, abs=1e-9)


def test_lorenz_is_proved_where_the_independent_box_fails(tmp_path: Path) -> None:
    """theory: L = (50, 100, 0), hold, any T_k <= 0.021 with 8 corners; the independent box fails at 0.005 already."""
    spec = made(LORENZ, tmp_path)
    plant, _ = resolve(spec.plant)

    def proved(slopes: Plant, T: str) -> bool:
        law = SamplingLaw("aperiodic", Exact(0), Exact(T))
        question = spec.observer.question(replace(slopes, sampling=law), {"L": ExactMatrix([[50], [100], [0]])}, 1)
        return GENERAL.propose(question) is not None

    assert proved(plant, "0.021")
    assert not proved(replace(plant, slopes=plant.slopes.apart), "0.005")


def test_a_gain_that_works_in_simulation_is_refuted_at_a_point_of_the_domain_only(tmp_path: Path) -> None:
    """L = (10, 25, 0): the independent box needs x = 20 and x = -20 at once; the joint class has (x, y, z) = (20,
    28, 0),
    where A + V - L C has an eigenvalue 1.3253, so some plant with these slopes defeats it at every period."""
    spec = made(LORENZ, tmp_path)
    plant, _ = resolve(spec.plant)
    gain = {"L": ExactMatrix([[10], [25], [0]])}
    at = replace(plant, sampling=SamplingLaw.periodic(Exact("0.02")))
    witness = refute(spec.observer.inclusion(at, gain), 0)
    assert witness is not None and witness.kind == "constant"
    x, y, z = (float(value) for value in witness.values[0])
    F = np.array([[-10, 10, 0], [28 + z, -1, x], [y, -x, -8 / 3]]) - np.array([[10, 0, 0], [25, 0, 0], [0, 0, 0]])
    assert max(np.linalg.eigvals(F).real) == pytest.approx(1.325312, abs=1e-6)
    apart = refute(spec.observer.inclusion(replace(at, slopes=at.slopes.apart), gain), 0)
    assert apart is not None and len(apart.values[0]) == 4


def test_a_word_of_the_joint_class_moves_entries_together(tmp_path: Path) -> None:
    spec = made(LORENZ, tmp_path)
    plant, _ = resolve(spec.plant)
    at = replace(plant, sampling=SamplingLaw.periodic(Exact("0.5")))
    inclusion = spec.observer.inclusion(at, {"L": ExactMatrix([[10], [25], [0]])})
    witness = refute(inclusion, 0)
    assert witness is not None and len(witness.values[0]) == 3
    for v in product(*zip(inclusion.floats.lower, inclusion.floats.upper, strict=True)):
        flow = inclusion.view_floats.flow(v)
        assert flow[1, 2] == -flow[2, 1]


def test_edited_bounds_of_a_function_are_not_believed(tmp_path: Path) -> None:
    plant, found = resolve(made(LORENZ, tmp_path).plant)
    smaller = with_found(made(LORENZ, tmp_path).plant, found | {"rho1": ("-10", "10")})
    assert "refuted" in {claim.status for claim in slope_claims(smaller)}
    entry = with_found(made(LORENZ, tmp_path).plant, found | {"2.1": ("0", "0.001")})  # what theorems on entries read
    assert "refuted" in {claim.status for claim in slope_claims(entry)}
    with pytest.raises(ValueError, match="do not share"):
        with_found(made(LORENZ, tmp_path).plant, found | {"rho4": ("0", "1")})
    rho = plant.slopes.joint[0]
    wrong = Quantity(rho.name, (*rho.weights, ((0, 0), Exact(1))), rho.lower, rho.upper, rho.function)
    other = replace(plant, slopes=replace(plant.slopes, joint=(wrong, *plant.slopes.joint[1:])))
    assert "undecided" in {claim.status for claim in slope_claims(other)}
