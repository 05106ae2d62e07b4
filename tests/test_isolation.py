"""One process a spec: a crash is one failed row, and no worker outlives its parent."""

from __future__ import annotations

import faulthandler
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from cdobs_cli.isolation import GRACE, each_isolated
from cdobs_cli.outcome import Job, Result

KILLS = int(os.environ.get("CDOBS_KILLS", "4"))


def call(job: Job, *, tell: Callable[[Result], None]) -> Result:
    spec = str(job.spec)
    if job.spec.name == "crash":
        faulthandler.disable()  # the crash is meant
        os.kill(os.getpid(), signal.SIGSEGV)
    if job.spec.name == "leave":
        os._exit(7)
    if job.spec.name.startswith("half"):
        tell(Result(spec, "ok", waiting=("check", "simulate")))
        tell(Result(spec, "ok", check={"verdict": "proved"}, summary=("proved",), waiting=("simulate",)))
    if job.spec.name in ("hang", "half"):
        time.sleep(60)
    return Result(spec, "ok")


def none(number: int) -> None:
    del number


def isolated(names: list[str], time_limit: float | None = None) -> dict[str, Result]:
    jobs = [Job(Path(name), Path("out") / name) for name in names]
    return {names[k]: result for k, result in each_isolated(jobs, call, workers=2, time_limit=time_limit, started=none)}


def test_crashes_and_limits_touch_one_spec_only() -> None:
    names = ["a", "crash", "b", "leave", "hang", "c"]
    jobs = [Job(Path(name), Path("out") / name) for name in names]
    started: list[int] = []
    results = dict(each_isolated(jobs, call, workers=2, time_limit=1.5, started=started.append))
    assert {names[number]: result.status for number, result in results.items()} == {
        "a": "ok", "b": "ok", "c": "ok", "crash": "failed", "leave": "failed", "hang": "finding",
    }  # fmt: skip
    assert sorted(started) == list(range(len(names)))
    assert "SIGSEGV" in results[1].messages[0].text
    assert "exit code 7" in results[3].messages[0].text
    assert "undecided" in results[4].messages[0].text


def test_what_was_known_when_the_time_ran_out_is_told() -> None:
    results = isolated(["half", "half done", "hang"], time_limit=1)
    late = results["half"]
    assert (late.status, late.check, late.summary) == ("finding", {"verdict": "proved"}, ("proved",))
    (message,) = late.messages
    assert message.text == (
        "undecided: simulate not finished within 1 s (--time-limit); what was proved and stored by then stands"
    )
    assert results["half done"] == Result("half done", "ok")  # what goes on in time is told once, at its end
    assert results["hang"].messages[0].text == "undecided: not finished within 1 s (--time-limit)"


def test_idle_workers_end_at_once() -> None:
    start = time.monotonic()
    assert len(isolated(["a", "b", "c"])) == 3
    assert time.monotonic() - start < GRACE


# Workers that say who they are, then sleep, compute in Python, compute in C without letting go, or wait for a job.
PARENT = """
import os, sys, time
from pathlib import Path
from cdobs_cli.outcome import Job
from cdobs_cli.isolation import each_isolated
from cdobs_cli.outcome import Result

def call(job, *, tell):
    Path("pids", str(os.getpid())).touch()
    if job.spec.name == "sleep":
        time.sleep(600)
    while job.spec.name == "python":
        pass
    while job.spec.name == "c":
        pow(7, 10**7)
    return Result(str(job.spec), "ok")

sys.platform = sys.argv[1]
names = ["idle", *sys.argv[2:]]
jobs = [Job(Path(name), Path(name)) for name in names]
list(each_isolated(jobs, call, workers=len(jobs), time_limit=None, started=lambda number: None))
"""


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def until(condition: Callable[[], bool], seconds: float = 30) -> bool:
    deadline = time.monotonic() + seconds
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.01)
    return condition()


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at /proc")
@pytest.mark.parametrize(("platform", "kills"), [(sys.platform, KILLS), ("one where the kernel does not tell", 1)])
def test_a_killed_parent_leaves_no_worker(tmp_path: Path, platform: str, kills: int) -> None:
    """Orphans after so many kills: none. A longer count: CDOBS_KILLS=50."""
    work = ["sleep", "python", "c"]
    for number in range(kills):
        folder = tmp_path / str(number) / "pids"
        folder.mkdir(parents=True)
        parent = subprocess.Popen([sys.executable, "-c", PARENT, platform, *work], cwd=folder.parent)
        assert until(lambda folder=folder: len(os.listdir(folder)) == 1 + len(work))  # type: ignore[misc]
        workers = [int(name) for name in os.listdir(folder)]
        assert all(map(alive, workers))
        parent.kill()
        parent.wait()
        until(lambda workers=workers: not any(map(alive, workers)))  # type: ignore[misc]
        orphans = [pid for pid in workers if alive(pid)]
        for pid in orphans:
            os.kill(pid, signal.SIGKILL)
        assert not orphans
