"""One process a spec: a crash is one failed row."""

from __future__ import annotations

import faulthandler
import os
import time
from pathlib import Path

from cdobs_cli.batch import Job
from cdobs_cli.isolation import GRACE, each_isolated
from cdobs_cli.outcome import Result


def call(job: Job) -> Result:
    if job.spec.name == "crash":
        faulthandler.disable()  # the crash is meant
        os.kill(os.getpid(), 11)
    if job.spec.name == "leave":
        os._exit(7)
    if job.spec.name == "hang":
        time.sleep(60)
    return Result(str(job.spec), "ok")


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


def test_idle_workers_end_at_once() -> None:
    jobs = [Job(Path(name), Path("out") / name) for name in "abc"]
    start = time.monotonic()
    assert len(dict(each_isolated(jobs, call, workers=2, time_limit=None, started=lambda number: None))) == 3
    assert time.monotonic() - start < GRACE
