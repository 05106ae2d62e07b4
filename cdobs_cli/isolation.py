"""Specs in worker processes: a crash, a limit or an interrupt touches one spec only."""

from __future__ import annotations

import gc
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Any, Protocol

from cdobs_cli.outcome import Job, Result, cut_short, failure
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from multiprocessing.process import BaseProcess

GRACE = 2.0  # seconds between asking a process to end and killing it
LONGEST = 86_400.0  # seconds that one wait may take; longer limits wait again
BEAT = 1.0  # seconds between two looks of a worker at its parent


class Call(Protocol):
    """What a worker does with a job; `tell` takes what is known while it goes on, and words about what is done."""

    def __call__(self, job: Job, *, tell: Callable[[Result | str], None]) -> Result: ...


@dataclass
class _Worker:
    """A process that takes one job after the other, so that each loads its modules once."""

    process: BaseProcess
    pipe: Connection
    number: int | None = None
    started: float = 0.0
    so_far: Result | None = None

    def late(self, time_limit: float | None) -> bool:
        return self.number is not None and time_limit is not None and time.monotonic() >= self.started + time_limit


def each_isolated(
    jobs: Sequence[Job], call: Call, *, workers: int, time_limit: float | None, started: Callable[[int], None],
    heard: Callable[[int, str], None] = lambda number, words: None,
) -> Generator[tuple[int, Result], None, None]:  # fmt: skip
    """(number, Result) of every job as it ends, `workers` at a time; `heard` gets the words about one that goes on.

    A job that outlives `time_limit` seconds is ended and left undecided, with what it had told by then; one whose
    process dies is a failed row; the next job then gets a new process. Closing the iterator, and the end of this
    process whatever its cause, end what is still running.
    """
    waiting = list(range(len(jobs)))[::-1]
    pool: list[_Worker] = []
    try:
        while waiting or any(worker.number is not None for worker in pool):
            while waiting and sum(worker.number is not None for worker in pool) < workers:
                worker = next((one for one in pool if one.number is None), None) or _start(call, pool)
                worker.number, worker.started, worker.so_far = waiting.pop(), time.monotonic(), None
                started(worker.number)
                _hand_over(worker, jobs[worker.number])
            for worker in _heard(pool, time_limit):
                number, result = worker.number, _result(worker, jobs, time_limit, heard)
                assert number is not None
                if result is None:
                    continue
                worker.number = None
                if not worker.process.is_alive():
                    pool.remove(worker)
                yield number, result
    finally:
        for worker in pool:
            worker.pipe.close()
            worker.process.terminate()
        for worker in pool:
            _end(worker.process)


def _start(call: Call, pool: list[_Worker]) -> _Worker:
    # A forked process has the modules of this one; where there is no fork, a new interpreter must do.
    forked = "fork" in multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("fork" if forked else "spawn")
    ours, theirs = context.Pipe()
    # A forked process holds the ends of this one too: while it does, nobody sees them close.
    inherited = (ours, *(worker.pipe for worker in pool)) if forked else ()
    arguments = (theirs, call, os.getpid(), inherited)
    process = context.Process(target=_work, args=arguments, daemon=True)  # type: ignore[attr-defined]
    if forked:
        gc.freeze()  # what is loaded stays: a worker need not look through it, nor copy it to do so
    with _signals_held():
        process.start()
        theirs.close()
        pool.append(_Worker(process, ours))
    return pool[-1]


@contextmanager
def _signals_held() -> Iterator[None]:
    """No interrupt between a process and its handlers, nor between a process and its place in the pool."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _hand_over(worker: _Worker, job: Job) -> None:
    try:
        worker.pipe.send(job)
    except OSError:
        worker.process.join(GRACE)  # it died while it was idle: told as a dead process when its pipe is read


def _heard(pool: list[_Worker], time_limit: float | None) -> list[_Worker]:
    """The busy workers that have something to tell, or have run out of time."""
    busy = [worker for worker in pool if worker.number is not None]
    patience = LONGEST
    if time_limit is not None:
        patience = min(LONGEST, max(0.0, min(worker.started + time_limit for worker in busy) - time.monotonic()))
    ready = wait([worker.pipe for worker in busy], patience)
    return [worker for worker in busy if worker.pipe in ready or worker.late(time_limit)]


def _result(
    worker: _Worker, jobs: Sequence[Job], time_limit: float | None, heard: Callable[[int, str], None]
) -> Result | None:
    """What became of the job; None while it goes on."""
    assert worker.number is not None
    seconds, spec = time.monotonic() - worker.started, str(jobs[worker.number].spec)
    try:
        while worker.pipe.poll():
            told: Result | str = worker.pipe.recv()
            if isinstance(told, str):
                heard(worker.number, told)
                continue
            if not told.waiting:
                return told
            worker.so_far = told
    except (EOFError, OSError):
        worker.process.join()
        code = worker.process.exitcode or 0
        how = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        text = f"its process ended with {how}; the other specs are not touched"
        return replace(failure(spec, text), seconds=seconds)
    if time_limit is None or not worker.late(time_limit):
        return None
    worker.process.terminate()
    _end(worker.process)
    return replace(cut_short(worker.so_far, spec, time_limit), seconds=seconds)


def _end(process: BaseProcess) -> None:
    process.join(GRACE)
    if process.is_alive():
        process.kill()
        process.join()


def _work(pipe: Connection, call: Call, parent: int, inherited: Sequence[Connection]) -> None:
    def stop(*_: Any) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        raise KeyboardInterrupt  # unwinds, so that no temporary file stays behind

    end_with(parent)
    for end in inherited:
        end.close()
    # Ctrl-C reaches the whole group: the parent alone decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, stop)
    try:
        if hasattr(signal, "pthread_sigmask"):
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGTERM})
        while True:
            pipe.send(call(pipe.recv(), tell=pipe.send))
    except (KeyboardInterrupt, EOFError, OSError):
        os._exit(0)  # asked to end, or nobody is left to be told


def end_with(parent: int) -> None:
    """End this process when its parent ends, whatever it computes and however the parent was killed."""
    if sys.platform == "linux":
        import ctypes

        set_parent_death_signal = 1
        ctypes.CDLL(None).prctl(set_parent_death_signal, signal.SIGKILL, 0, 0, 0)
        if os.getppid() != parent:
            os._exit(0)  # it was killed before the kernel was asked
    else:
        threading.Thread(target=_look_at, args=(parent,), daemon=True).start()


def _look_at(parent: int) -> None:
    """Where the kernel does not tell: look again and again. (Elsewhere an orphan has another parent at once.)"""
    while os.getppid() == parent:
        time.sleep(BEAT)
    os._exit(0)
