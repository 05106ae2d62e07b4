"""One spec, one process: a crash, a limit or an interrupt touches that spec only."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Any

from cdobs_cli.outcome import Message, Result

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

    from cdobs_cli.batch import Job

GRACE = 2.0  # seconds between asking a process to end and killing it


@dataclass
class _Running:
    number: int
    job: Job
    process: BaseProcess
    pipe: Connection
    started: float


def each_isolated(
    jobs: Sequence[Job],
    call: Callable[[Job], Result],
    *,
    workers: int,
    time_limit: float | None,
    started: Callable[[int], None],
) -> Iterator[tuple[int, Result]]:
    """(number, Result) of every job as it ends, `workers` at a time.

    A job that outlives `time_limit` seconds is ended and left undecided; one whose process dies is a
    failed row. Closing the iterator ends what is still running.
    """
    # A forked process has everything loaded already; where there is no fork, a new interpreter must do.
    context = multiprocessing.get_context("fork" if "fork" in multiprocessing.get_all_start_methods() else "spawn")
    waiting = list(enumerate(jobs))[::-1]
    running: list[_Running] = []
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                number, job = waiting.pop()
                receiver, sender = context.Pipe(duplex=False)
                process = context.Process(target=_child, args=(sender, call, job), daemon=True)  # type: ignore[attr-defined]
                process.start()
                sender.close()
                running.append(_Running(number, job, process, receiver, time.monotonic()))
                started(number)
            for one in _ended(running, time_limit):
                running.remove(one)
                yield one.number, _result(one, time_limit)
    finally:
        for one in running:
            _end(one.process)


def _ended(running: list[_Running], time_limit: float | None) -> list[_Running]:
    now = time.monotonic()
    patience = None if time_limit is None else max(0.0, min(one.started + time_limit - now for one in running))
    ready = wait([one.pipe for one in running], patience)
    now = time.monotonic()
    return [one for one in running if one.pipe in ready or (time_limit is not None and now >= one.started + time_limit)]


def _result(one: _Running, time_limit: float | None) -> Result:
    seconds = time.monotonic() - one.started
    spec = str(one.job.spec)
    if not one.pipe.poll():
        _end(one.process)
        text = f"undecided: not finished within {time_limit:g} s (--time-limit)"
        return Result(spec, "finding", (Message("error", text, spec, rule="time-limit"),), seconds=seconds)
    try:
        result: Result = one.pipe.recv()
        one.process.join()
        return result
    except EOFError:
        one.process.join()
        code = one.process.exitcode or 0
        how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        text = f"its process ended with {how}; the other specs are not touched"
        return Result(spec, "failed", (Message("error", text, spec, rule="tool"),), seconds=seconds)


def _end(process: BaseProcess) -> None:
    process.terminate()
    process.join(GRACE)
    if process.is_alive():
        process.kill()
        process.join()


def _child(pipe: Connection, call: Callable[[Job], Result], job: Job) -> None:
    def stop(*_: Any) -> None:
        raise KeyboardInterrupt  # unwinds, so that no temporary file stays behind

    signal.signal(signal.SIGTERM, stop)
    try:
        pipe.send(call(job))
    except KeyboardInterrupt:
        os._exit(130)
    finally:
        pipe.close()
