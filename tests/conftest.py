"""What several tests need: the command line as a user runs it, and a small spec."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from command import PENDULUM, ROOT, Cdobs


@pytest.fixture(scope="session", autouse=True)
def libraries(tmp_path_factory: pytest.TempPathFactory) -> None:
    """What is compiled is kept for the session, and not among the user's."""
    os.environ["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("cache"))


@pytest.fixture
def pendulum() -> str:
    return PENDULUM


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with p.yaml, the pendulum, and its results; to be copied."""
    from cdobs_cli.batch import Settings, run
    from cdobs_cli.outcome import STAGES, Job

    folder = tmp_path_factory.mktemp("finished")
    (folder / "p.yaml").write_text(PENDULUM)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run(Job(Path("p.yaml"), Path("results/p")), STAGES, Settings()).status == "ok"
    return folder


@pytest.fixture
def cdobs(tmp_path: Path) -> Cdobs:
    """Run the command in an empty folder, as its own process."""

    def run(
        *arguments: object, env: dict[str, str] | None = None, timeout: float = 120
    ) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "cdobs_cli", *map(str, arguments)],
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(ROOT)} | (env or {}),
            capture_output=True,
            text=True,
            timeout=timeout,
            stdin=subprocess.DEVNULL,
            check=False,
        )

    return run
