"""The rules of docs/sweep.md under Snakemake itself: the table is that of one command."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from command import PENDULUM, ROOT, forked

GIVEN = PENDULUM.split("simulation:")[0] + "  gain: {K: [[1], [1.8361]]}\n"
GRID = "measurement.sampling.period=0.3,1.5"


def rules() -> str:
    """Those of the page, with fewer parts and points."""
    block = re.search(r"As a `Snakefile`:\n\n```python\n(.*?)```", (ROOT / "docs/sweep.md").read_text(), re.DOTALL)
    assert block is not None
    text = re.sub(r"PARTS = (.*), \d+", r"PARTS = \1, 2", block[1])
    return re.sub(r'GRID = "--set .*"', f'GRID = "--set {GRID} --effort 0"', text)


def test_the_rules_make_the_table(tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        (folder / "specs").mkdir(parents=True)
        (folder / "specs/motor.yaml").write_text(GIVEN)
    (there / "Snakefile").write_text(rules())
    home = {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": str(ROOT)}
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        [sys.executable, "-m", "snakemake", "--cores", "1"],
        cwd=there, env={**os.environ, **home, "PATH": path}, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert forked(["sweep", "specs/motor.yaml", "--set", GRID, "--effort", "0"], here).returncode == 1
    table = "results/motor/sweep/sweep.csv"
    assert (there / table).read_bytes() == (here / table).read_bytes()
    assert {"proved", "refuted"} <= set(re.split("[,\n]", (there / table).read_text()))
