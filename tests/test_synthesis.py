"""The making of a design: what the solver was asked stands in it, whatever the family; a panic of it ends nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import ROOT

from cdobs_cli.certify.lmi import SparseColumns, compressed
from cdobs_cli.design import Design
from cdobs_cli.spec.model import load
from cdobs_cli.synthesis import new_design

ASKING = ("interval_scalar", "lpv_zoh_sine", "reachability_chain3", "updated_sampling_unstable")


def design(name: str) -> Design:
    return new_design(load(ROOT / "specs" / f"{name}.yaml"), effort=0)


@pytest.mark.parametrize("name", ASKING)
def test_every_call_of_the_solver_is_recorded(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    import clarabel

    asked: list[int] = []

    class Counted:
        def __init__(self, *problem: Any) -> None:
            self.solver = solver(*problem)

        def solve(self) -> Any:
            solution = self.solver.solve()
            asked.append(solution.iterations)
            return solution

    solver = clarabel.DefaultSolver
    monkeypatch.setattr(clarabel, "DefaultSolver", Counted)
    record = design(name).solver
    assert record is not None
    assert (record.name, record.version, record.iterations) == ("clarabel", clarabel.__version__, sum(asked))


def test_a_design_found_without_the_solver_names_none(tmp_path: Path) -> None:
    text = (ROOT / "specs" / "reachability_pendulum.yaml").read_text()
    path = tmp_path / "spec.yaml"
    path.write_text(text.replace("family: reachability", "family: reachability\n  method: set"))
    by_set = new_design(load(path), effort=0)
    assert by_set.outcome == "found"
    assert by_set.solver is None


def panic() -> BaseException:
    """What Rust panics with, of the very class."""
    import clarabel

    beyond = SparseColumns(np.ones(3), np.array([0, 1, 7]), np.arange(4), (3, 3))
    cones = [clarabel.PSDTriangleConeT(2)]
    settings = clarabel.DefaultSettings()
    with pytest.raises(BaseException, match="out of bounds") as caught:
        clarabel.DefaultSolver(compressed(np.zeros((3, 3))), np.ones(3), beyond, np.ones(3), cones, settings)
    assert not isinstance(caught.value, Exception)
    return caught.value


@pytest.mark.parametrize("name", ASKING)
def test_a_solver_that_panics_leaves_a_design_without_its_help(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    import clarabel

    error = panic()

    def ask(*problem: Any) -> Any:
        raise error

    monkeypatch.setattr(clarabel, "DefaultSolver", ask)
    made = design(name)
    assert made.outcome in ("none", "given") or made.certificates
    assert made.solver is not None
    assert (made.solver.status, made.solver.iterations) == ("Panicked", 0)
