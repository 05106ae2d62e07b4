"""Specs on the workers of a Dask cluster: each in a process and a folder of its own there, its files brought back.

Who loses a worker loses nothing: the scheduler gives what it had to another. Dask is an extra, loaded only here.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cdobs_cli.errors import SpecError, ToolError, UsageError, untold
from cdobs_cli.isolation import Call, each_isolated, end_with
from cdobs_cli.outcome import Job, Result, failure
from cdobs_cli.records import dataclass
from cdobs_cli.spec.plant_file import read_plant_file
from cdobs_cli.spec.reader import read
from cdobs_cli.store import read_regular, write_atomically

if TYPE_CHECKING:
    from distributed import Client

_ANSWER = 15.0  # seconds that a scheduler has to answer
_DASK = "dask="
Files = dict[str, bytes]


@dataclass(frozen=True)
class Parcel:
    """What a worker needs: the job with paths below a folder, the files there, what to do, and its limit in seconds."""

    job: Job
    files: Files
    call: Call
    time_limit: float | None


@dataclass(frozen=True)
class Cluster:
    """The workers of the scheduler at an address."""

    address: str

    @staticmethod
    def of(text: str) -> Cluster:
        """`dask=tcp://host:8786`. Raises: UsageError."""
        address = text.removeprefix(_DASK)
        if not text.startswith(_DASK) or not address:
            raise UsageError(f"--executor {text}: dask=ADDRESS is expected, the address of a Dask scheduler")
        return Cluster(address)

    def each(
        self, jobs: Sequence[Job], call: Call, *, workers: int, time_limit: float | None,
        started: Callable[[int], None], heard: Callable[[int, str], None] = lambda number, words: None,
    ) -> Generator[tuple[int, Result], None, None]:  # fmt: skip
        """As `each_isolated`, but that the cluster says how many at a time, and nothing is heard on the way.

        Raises: UsageError, where Dask is not there or a path leads out of this folder; ToolError, where no scheduler
        answers.
        """
        parcels = [_parcel(job, call, time_limit) for job in jobs]
        if not parcels:
            return
        client = self._client()
        try:
            from distributed import as_completed

            futures = {}
            for number, parcel in enumerate(parcels):
                futures[client.submit(opened, parcel, pure=False)] = number
                started(number)
            for future in as_completed(list(futures)):
                number = futures.pop(future)
                yield number, _brought(jobs[number], future)
                future.release()
        finally:
            with suppress(Exception):
                client.cancel(list(futures), force=True)
                client.close(timeout=_ANSWER)

    def _client(self) -> Client:
        try:
            from distributed import Client
        except ImportError:
            raise UsageError("--executor dask=.. needs Dask: pip install 'cdobs[dask]'") from None
        try:
            return Client(self.address, timeout=_ANSWER)
        except (OSError, ValueError, TypeError) as error:
            raise ToolError(f"no Dask scheduler answers at {self.address}: {error}") from error


def _brought(job: Job, future: Any) -> Result:
    """The result, once its files stand in the job's folder."""
    try:
        result, files = future.result()
    except Exception as error:  # whatever befell the workers
        return failure(str(job.spec), f"its workers failed, {type(error).__name__}: {error}")
    for name, content in files.items():
        write_atomically(job.folder / name, content)
    found: Result = result
    return found


def _parcel(job: Job, call: Call, time_limit: float | None) -> Parcel:
    """With the spec, its plant's file, and what stands in its folder, so that nothing is done again."""
    for path in (job.spec, job.folder):
        if path.is_absolute() or ".." in path.parts:
            raise UsageError(f"{path}: with --executor, specs and results lie below the working folder")
    sources = [job.spec, *_plant_file(job.spec)]
    stored = (path for folder in (job.folder, job.folder / "figures") if folder.is_dir() for path in folder.iterdir())
    files = {str(path): content for path in (*sources, *stored) if path.is_file() and path.suffix != ".tmp"
             and (content := read_regular(path)) is not None}  # fmt: skip
    return Parcel(job, files, call, time_limit)


def _plant_file(spec: Path) -> list[Path]:
    """The file that the plant stands in, where it may be read; mistakes are told by whoever reads the spec."""
    try:
        name = read(spec).root["plant"]["file"]
        read_plant_file(spec, name)
    except (SpecError, KeyError, TypeError):
        return []
    return [spec.parent / name]


# ---------------------------------------------------------------- on the worker


def opened(parcel: Parcel) -> tuple[Result, Files]:
    """Carry a parcel out in a process of its own, in a folder that is gone afterwards; the result, and new files."""
    with tempfile.TemporaryDirectory(prefix="cdobs-") as folder:
        top = Path(folder)
        for name, content in parcel.files.items():
            write_atomically(top / name, content)
        # Python's path as it is here: the process finds the same package.
        env = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        done = subprocess.run(  # noqa: S603 (this interpreter and this module)
            [sys.executable, "-m", "cdobs_cli.remote", str(os.getpid())], input=pickle.dumps(parcel), cwd=top, env=env,
            capture_output=True, check=False,
        )  # fmt: skip
        if done.returncode != 0:
            told = done.stderr.decode("utf-8", "replace").strip().splitlines()[-1:]
            return failure(str(parcel.job.spec), f"its process on a worker ended badly: {''.join(told)}"), {}
        result: Result = pickle.loads(done.stdout)  # noqa: S301 (written by the process that was just run)
        return result, _new_files(top, parcel.job.folder, parcel.files)


def _new_files(top: Path, folder: Path, known: Mapping[str, bytes]) -> Files:
    """Of the job's folder, by names relative to it."""
    there = sorted(path for path in (top / folder).rglob("*") if path.is_file() and path.suffix != ".tmp")
    found = {path: path.read_bytes() for path in there}
    changed = {path: one for path, one in found.items() if known.get(str(path.relative_to(top))) != one}
    return {path.relative_to(top / folder).as_posix(): one for path, one in changed.items()}


def _inside() -> None:
    """The process of a parcel: read it, carry it out under its limit, write the result."""
    end_with(int(sys.argv[1]))
    parcel: Parcel = pickle.load(sys.stdin.buffer)  # noqa: S301 (from the worker that started this process)
    out, sys.stdout = sys.stdout.buffer, sys.stderr  # nothing else is written where the result goes
    jobs, limit = [parcel.job], parcel.time_limit
    with closing(each_isolated(jobs, parcel.call, workers=1, time_limit=limit, started=lambda _: None)) as ended:
        for _, result in ended:
            out.write(pickle.dumps(result))
    out.flush()


if __name__ == "__main__":
    from cdobs_cli.remote import _inside as inside  # pickles name this module by its own name

    try:
        inside()
    except Exception as error:  # told by the last line
        print(untold(error), file=sys.stderr)  # noqa: T201
        sys.exit(1)
