"""The import contracts hold, and a planted import breaks each of them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from command import ROOT

LINT = Path(sys.executable).with_name("lint-imports")


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package beside its contracts."""
    folder = tmp_path_factory.mktemp("planted")
    shutil.copytree(ROOT / "cdobs_cli", folder / "cdobs_cli", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def contracts(folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [LINT, "--no-cache"],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    ("module", "planted", "contract"),
    [
        (
            "families/interval/observer.py",
            "import cdobs_cli.families.lpv_zoh.theorems",
            "Families never import one another",
        ),
        ("certify/definite.py", "import cdobs_cli.bounds.region", "Imports run one way"),
        ("bounds/region.py", "import cdobs_cli.certify.definite", "Imports run one way"),
        ("exact/numbers.py", "import cdobs_cli.plant", "Imports run one way"),
        ("simulate/engine.py", "import cdobs_cli.report.text", "Imports run one way"),
        ("batch.py", "import cdobs_cli.sweep.run", "Imports run one way"),
        ("sweep/points.py", "import cdobs_cli.compare.entries", "Imports run one way"),
        ("batch.py", "import distributed", "Only remote.py asks a cluster"),
        ("spec/replaced.py", "import cdobs_cli.sweep.grid", "Imports run one way"),
        ("sweep/charts.py", "import matplotlib", "Only report/figures.py draws"),
        ("export/c99.py", "import cdobs_cli.simulate.engine", "Imports run one way"),
        ("pipeline.py", "import matplotlib", "Only report/figures.py draws"),
        ("certify/methods/base.py", "import cdobs_cli.certify.judge", "Methods know no objective and no verdict"),
        ("certify/methods/spectral.py", "import clarabel", "Only certify/lmi.py asks the solver"),
        ("stray.py", "", "Imports run one way"),
    ],
)
def test_a_planted_import_breaks_a_contract(package: Path, module: str, planted: str, contract: str) -> None:
    path = package / "cdobs_cli" / module
    before = path.read_text() if path.exists() else None
    path.write_text(f"{before or ''}\n{planted}\n")
    try:
        done = contracts(package)
    finally:
        if before is None:
            path.unlink()
        else:
            path.write_text(before)
    assert done.returncode != 0
    assert f"{contract} BROKEN" in done.stdout or (module == "stray.py" and "stray" in done.stdout)


def test_the_contracts_hold(package: Path) -> None:
    assert contracts(package).returncode == 0
