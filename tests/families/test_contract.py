"""What every family owes the rest of the tool. New families are tested by being registered."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import pytest
from designing import designed

from cdobs_cli.certificate import Check
from cdobs_cli.design import Design
from cdobs_cli.families import FAMILIES
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.report.references import bibliography
from cdobs_cli.spec.model import Spec, load

SMALLER_IS_BETTER = {"final_width", "min_width", "gamma"}


@pytest.fixture(scope="module", params=sorted(FAMILIES))
def example(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Spec, Design, Check]:
    path = tmp_path_factory.mktemp(request.param) / "example.yaml"
    path.write_text(FAMILIES[request.param].example())
    spec = load(path)
    design = designed(spec.observer, spec.plant, 1)
    return spec, design, spec.observer.certify(spec.plant, design, 1)


def test_the_example_is_proved(example: tuple[Spec, Design, Check]) -> None:
    spec, design, check = example
    assert spec.observer.name == design.family
    assert design.outcome in ("found", "given")
    assert [claim.id for claim in check.claims if claim.required] == ["convergence"]
    assert check.verdict == "proved"
    convergence = check.claim("convergence")
    assert convergence is not None and convergence.by is not None


def test_claims_are_told_apart_and_sourced(example: tuple[Spec, Design, Check]) -> None:
    _, _, check = example
    identifiers = [claim.id for claim in check.claims]
    assert len(identifiers) == len(set(identifiers))
    for claim in check.claims:
        assert claim.statement
        assert claim.source
        assert set(re.findall(r"[A-Z][A-Za-z]+\d{4}", claim.source)) <= set(bibliography())
        if claim.status == "refuted" and claim.required:
            assert claim.witness is not None


def test_no_bound_is_proved_and_refuted(example: tuple[Spec, Design, Check]) -> None:
    for name, bound in example[2].bounds.items():
        if None in (bound.proved, bound.refuted) or "inf" in (bound.proved, bound.refuted):
            continue
        proved, refuted = Fraction(bound.proved), Fraction(bound.refuted)
        assert proved >= refuted if name.partition(".")[0] in SMALLER_IS_BETTER else proved <= refuted, name


def test_artefacts_survive_json(example: tuple[Spec, Design, Check]) -> None:
    _, design, check = example
    again = Design.from_document(json.loads(json.dumps(design.document(), allow_nan=False)))
    assert again.document() == design.document()
    assert Check.from_document(json.loads(json.dumps(check.document(), allow_nan=False))).document() == check.document()


def test_without_certificates_nothing_is_proved_by_them(example: tuple[Spec, Design, Check]) -> None:
    spec, design, check = example
    if design.certificates:
        bare = dataclasses.replace(design, certificates=())
        convergence = spec.observer.certify(spec.plant, bare, 0).claim("convergence")
        before = check.claim("convergence")
        assert convergence is not None and before is not None
        assert convergence.status != "proved" or convergence.by != before.by


def test_observers_are_closed_systems(example: tuple[Spec, Design, Check]) -> None:
    spec, design, _ = example
    system = HybridSystem(spec.plant, spec.observer.observer(spec.plant, design))
    observer, plant = system.observer, spec.plant
    known = {*system.states, *(source.name for source in plant.inputs), *observer.control, "t"}
    disturbances = {f"d.{i}" for i in range(plant.n)}
    measured = {f"y.{k}" for k in range(plant.p)}
    starts = {f"{kind}.{name}" for kind in ("initial", "lower", "upper") for name in plant.states} | measured
    assert len(observer.states) == len(observer.flow) == len(observer.jump) == len(observer.start)
    assert all(expression.variables <= known | disturbances for expression in system.flow)
    assert all(expression.variables <= known | measured | {"elapsed"} for jump in system.jumps for expression in jump)
    assert all(expression.variables <= starts for expression in observer.start)
    assert all(len(rows) == plant.n for rows in observer.estimates.values())


def test_certify_loads_no_solver(example: tuple[Spec, Design, Check], tmp_path: Path) -> None:
    spec, design, _ = example
    (tmp_path / "spec.yaml").write_bytes(Path(spec.source_path).read_bytes())
    (tmp_path / "design.json").write_text(json.dumps(design.document()))
    code = (
        "import json, sys\n"
        "from cdobs_cli.design import Design\nfrom cdobs_cli.spec.model import load\n"
        "spec, design = load('spec.yaml'), Design.from_document(json.load(open('design.json')))\n"
        "check = spec.observer.certify(spec.plant, design, 1)\n"
        "assert check.verdict == 'proved', check\n"
        "heavy = {'cvxpy', 'clarabel', 'matplotlib', 'sympy'}\n"
        "print(*sorted(heavy & {name.partition('.')[0] for name in sys.modules}))\n"
    )
    root = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={"PYTHONPATH": str(root), "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == ""
