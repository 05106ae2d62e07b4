"""Units of FMI: valid for a checker of others, and equal to the simulator however their steps fall."""

from __future__ import annotations

import shutil
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exporting import Ready, ready

from cdobs_cli.errors import UsageError
from cdobs_cli.export.fmu import fmu_bytes
from cdobs_cli.library import compiler

CASES = [("reachability", "periodic"), ("lpv_zoh", "periodic"), ("shipped", "reachability_range_bearing")]
runs = pytest.mark.skipif(compiler() is None, reason="no compiler")


def written(one: Ready, folder: Path) -> Path:
    path = folder / f"{one.portable.name}.fmu"
    path.write_bytes(fmu_bytes(one.portable, one.about, one.vectors, one.design.sampling))
    return path


def begun(path: Path) -> tuple[Any, dict[str, int]]:
    """The unit after its initialization, and the numbers of its variables."""
    fmpy = pytest.importorskip("fmpy")
    from fmpy.fmi2 import FMU2Slave

    told, folder = fmpy.read_model_description(str(path)), fmpy.extract(str(path))
    unit = FMU2Slave(guid=told.guid, unzipDirectory=folder, instanceName="one",
                     modelIdentifier=told.coSimulation.modelIdentifier)  # fmt: skip
    unit.instantiate()
    unit.setupExperiment(startTime=0.0)
    unit.enterInitializationMode()
    unit.exitInitializationMode()
    return unit, {one.name: one.valueReference for one in told.modelVariables}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("parts", [1, 3])
@runs
def test_it_is_valid_and_runs_as_simulated(case: tuple[str, str], parts: int, tmp_path: Path) -> None:
    pytest.importorskip("fmpy")
    from fmpy.validation import validate_fmu

    one = ready(case)
    path = written(one, tmp_path)
    assert validate_fmu(str(path)) == []
    unit, at = begun(path)
    outputs = [number for name, number in at.items() if name.startswith("x_")]
    inputs = [number for name, number in at.items() if name.startswith("input.")]
    t, compared = 0.0, 0
    for call in one.vectors.calls:
        if call.kind == "correct":
            unit.setReal([at[f"y{k + 1}"] for k in range(len(call.y))], call.y)
            unit.doStep(t, 0.0)
        else:
            unit.setReal(inputs, call.u[: len(inputs)])
            for _ in range(parts):
                unit.doStep(t, call.dt / parts)
                t += call.dt / parts
        if call.expected and call.kind == "correct":
            scale = np.array(one.vectors.scale)
            assert np.array(unit.getReal(outputs)) / scale == pytest.approx(np.array(call.expected) / scale, abs=1e-8)
            compared += 1
    assert compared > 5
    unit.terminate()
    unit.freeInstance()
    shutil.rmtree(unit.unzipDirectory)


@runs
def test_a_step_over_many_samples_takes_them_all_and_a_state_comes_back(tmp_path: Path) -> None:
    one = ready(("reachability", "periodic"))
    path = written(one, tmp_path)
    (whole, at), (parted, _) = begun(path), begun(path)
    outputs = [at["x_hat.theta"], at["x_hat.omega"]]
    for unit in (whole, parted):
        unit.setReal([at["y1"]], [0.3])
    whole.doStep(0.0, 1.5)
    kept = parted.getFMUstate()
    parted.doStep(0.0, 7.0)
    parted.setFMUstate(kept)
    for k, h in enumerate((0.6, 0.6, 0.3)):
        parted.doStep(0.6 * k, h)
    assert whole.getReal(outputs) == pytest.approx(parted.getReal(outputs), abs=1e-12)
    with pytest.raises(Exception, match="fmi2"):
        whole.getReal([99])


def test_files_are_equal_and_hold_their_sources(tmp_path: Path) -> None:
    one = ready(("reachability", "periodic"))
    path = written(one, tmp_path)
    assert path.read_bytes() == fmu_bytes(one.portable, one.about, one.vectors, one.design.sampling)
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
        source = archive.read(f"sources/{one.portable.name}_fmu.c").decode("ascii")
    assert "modelDescription.xml" in names and "fmi2DoStep" in source and '#include "' not in source
    assert any(name.startswith("binaries/") for name in names) == (compiler() is not None)


@pytest.mark.parametrize(
    "case",
    [*(("reachability", scheme) for scheme in ("multirate", "late", "on_change")), ("shipped", "interval_scalar")],
)
def test_other_schemes_say_what_to_write_instead(case: tuple[str, str], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="write --to c99"):
        written(ready(case), tmp_path)
