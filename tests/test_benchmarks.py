"""The benchmarks are run by hand: here, that each finds what it imports from any folder, and that the table gathers."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from command import ROOT

FOLDER = ROOT / "tests" / "benchmarks"
SCRIPTS = sorted(path.stem for path in FOLDER.glob("*.py"))
BARE = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


def ran(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=folder, env=BARE, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("script", SCRIPTS)
def test_every_script_starts_without_a_path_set_by_hand(tmp_path: Path, script: str) -> None:
    """Where it reads the package, that of this checkout."""
    text = f"""import sys
sys.path.insert(0, {str(FOLDER)!r})
import {script}
package = sys.modules.get("cdobs_cli")
assert package is None or package.__file__.startswith({str(ROOT)!r}), package"""
    done = ran(tmp_path, "-c", text)
    assert done.returncode == 0, done.stderr


def test_the_table_ends_with_the_rows_of_all_scripts(tmp_path: Path) -> None:
    for name, rows in {"one": 'row("quick", 1, 2, 1)', "two": 'row("slow", 3, 2, 1)\nraise SystemExit(1)'}.items():
        text = f"import sys\nsys.path.insert(0, {str(FOLDER)!r})\nfrom table import row\n{rows}\n"
        (tmp_path / f"{name}.py").write_text(text)
    done = ran(tmp_path, str(FOLDER / "table.py"), "one.py", "two.py")
    head, quick, slow, failed = done.stdout.splitlines()[-4:]
    assert head.split() == ["name", "measured", "reference", "ratio", "wanted"]
    assert quick.split() == ["quick", "1", "s", "2", "s", "0.5", "<=", "1"]
    assert slow.split() == ["slow", "3", "s", "2", "s", "1.5", "<=", "1", "MISSED"]
    assert failed == "failed: two.py"
    assert done.returncode == 1
