"""A Dask cluster with real worker processes: the same bytes as here, also when a worker is killed under way."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from command import PENDULUM, forked
from test_sweep import GIVEN, PERIODS, content, sweep

from cdobs_cli.remote import Cluster

WAIT = 60.0


def test_what_is_no_executor_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for text in ("dask", "dask=", "slurm=x", ""):
        done = sweep(tmp_path, *PERIODS, "--executor", text)
        assert done.returncode == 2 and "dask=ADDRESS is expected" in done.stderr
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    done = sweep(tmp_path, *PERIODS, "--executor", "dask=tcp://127.0.0.1:1")
    assert done.returncode == 2 and "pip install 'cdobs[dask]'" in done.stderr


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as one:
        yield one


def workers(cluster: Any) -> list[int]:
    """Process ids."""
    from distributed import Client

    with Client(cluster, set_as_default=False) as client:
        return sorted(client.run(os.getpid).values())


def test_no_scheduler_answers(cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cdobs_cli.remote._ANSWER", 0.5)
    done = sweep(tmp_path, *PERIODS, "--executor", "dask=tcp://127.0.0.1:1")
    assert done.returncode == 3 and "no Dask scheduler answers at tcp://127.0.0.1:1" in done.stderr


def test_a_worker_that_is_killed_loses_nothing(cluster: Any, tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
    assert sweep(here, *PERIODS).returncode == 1
    before, killed = workers(cluster), []

    def kill_one() -> None:
        deadline = time.monotonic() + WAIT
        while time.monotonic() < deadline and not killed:
            busy = [pid for pid in before if children(pid)]
            if busy:
                killed.append((busy[0], children(busy[0])))
                os.kill(busy[0], signal.SIGKILL)
            time.sleep(0.01)

    killer = threading.Thread(target=kill_one)
    killer.start()
    done = forked(["sweep", "p.yaml", "--effort", "0", *PERIODS, "--executor", f"dask={cluster.scheduler_address}"],
                  with_spec(there, GIVEN), timeout=2 * WAIT)  # fmt: skip
    killer.join()
    assert killed and done.returncode == 1, done.stderr
    assert content(there) == content(here)
    assert all(done.stdout.count(f"period={period})") == 1 for period in ("0.3", "0.6", "0.9", "1.2", "1.5"))
    deadline = time.monotonic() + WAIT
    while any(map(is_alive, killed[0][1])) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(is_alive, killed[0][1])), "what it had started ends with it"


def test_run_does_the_same_there(cluster: Any, tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    wrong = PENDULUM.replace("states", "stats")
    for folder, more in ((here, ()), (there, ("--executor", f"dask={cluster.scheduler_address}"))):
        (folder / "specs").mkdir(parents=True)
        with_spec(folder / "specs", PENDULUM)
        (folder / "specs" / "wrong.yaml").write_text(wrong)
        done = forked(["run", "specs", "--effort", "0", *more], folder, timeout=WAIT)
        assert done.returncode == 2 and "specs/wrong.yaml:4" in done.stderr
    files = {path.relative_to(here) for path in here.rglob("*") if path.is_file() and "results" in path.parts}
    assert files == {path.relative_to(there) for path in there.rglob("*") if path.is_file() and "results" in path.parts}
    assert all((here / name).read_bytes() == (there / name).read_bytes() for name in files)
    before = {name: (there / name).stat().st_mtime_ns for name in files if name.name == "design.json"}
    forked(["run", "specs", "--effort", "0", "--executor", f"dask={cluster.scheduler_address}"], there, timeout=WAIT)
    assert {name: (there / name).stat().st_mtime_ns for name in before} == before
    outside = forked(["run", str(there / "specs"), "--executor", f"dask={cluster.scheduler_address}"], there)
    assert outside.returncode == 2 and "below the working folder" in outside.stderr


def test_an_address() -> None:
    assert Cluster.of("dask=tcp://h:8786").address == "tcp://h:8786"


def with_spec(folder: Path, text: str) -> Path:
    (folder / "p.yaml").write_text(text)
    return folder


def children(pid: int) -> list[int]:
    """Processes that carry out parcels of a worker."""
    found = []
    for one in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(one.read_text().rpartition(")")[2].split()[1])
            is_ours = b"cdobs_cli.remote" in (one.parent / "cmdline").read_bytes()
        except OSError:
            continue
        if parent == pid and is_ours:
            found.append(int(one.parent.name))
    return found


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
