"""Certificates are proved once for all that is asked of a design: a proof hangs on nothing but what it is about."""

from dataclasses import replace
from pathlib import Path

import pytest

from cdobs_cli.certify.judge import judgement_of
from cdobs_cli.spec.model import load
from cdobs_cli.synthesis import new_design, plant_of

SPECS = Path(__file__).parents[2] / "specs"


@pytest.mark.parametrize("name", ["reachability_pendulum_set", "reachability_feedforward", "lpv_zoh_duffing"])
def test_proofs_do_not_hang_on_the_effort(name):
    spec = load(SPECS / f"{name}.yaml")
    design = new_design(spec, 0)
    plant = plant_of(spec, design)
    proved = []
    for effort in (0, 3):
        # Another object, so that nothing is remembered of the one before.
        items = judgement_of(spec.observer, plant, replace(design), effort).items
        proved.append([(item.method.name, item.proof.holds, str(item.proof.rate)) for item in items])
    assert proved[0] == proved[1]
    assert any(holds for _, holds, _ in proved[0])


def test_a_design_is_not_judged_by_another_ones_proofs():
    spec = load(SPECS / "reachability_pendulum_set.yaml")
    design = new_design(spec, 0)
    plant = plant_of(spec, design)
    assert judgement_of(spec.observer, plant, design, 0).covering
    worse = {letter: type(gain)([["0"] for _ in gain.rows]) for letter, gain in design.gain.items()}
    assert not judgement_of(spec.observer, plant, replace(design, gain=worse), 0).covering
    assert judgement_of(spec.observer, plant, design, 0).covering
