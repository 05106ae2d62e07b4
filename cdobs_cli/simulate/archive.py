"""A run as arrays, and as the bytes of `simulation.npz`.

Keys: t, x, one per estimate (x_hat, or x_lower and x_upper), t_k, y_k, `input.<name>`, `internal.<name>`;
all runs one after the other, run r in [offsets[r], offsets[r + 1]) of what is over t and
[sample_offsets[r], sample_offsets[r + 1]) of t_k and y_k; `stopped`, one text a run, empty where none.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.errors import ArtefactError
from cdobs_cli.run import Run, RunSummary, Trajectory

if TYPE_CHECKING:
    from numpy.typing import NDArray


def arrays(run: Run) -> dict[str, NDArray[Any]]:
    """Every array of a run, by key."""
    every = run.trajectories
    first = every[0]
    result: dict[str, NDArray[Any]] = {
        "t": np.concatenate([one.t for one in every]),
        "x": np.concatenate([one.x for one in every]),
        "t_k": np.concatenate([one.t_k for one in every]),
        "y_k": np.concatenate([one.y_k for one in every]),
    }
    result |= {name: np.concatenate([one.estimates[name] for one in every]) for name in first.estimates}
    result |= {f"input.{name}": np.concatenate([one.inputs[name] for one in every]) for name in first.inputs}
    result |= {f"internal.{name}": np.concatenate([one.internals[name] for one in every]) for name in first.internals}
    result["offsets"] = np.cumsum([0, *(len(one.t) for one in every)], dtype=np.int64)
    result["sample_offsets"] = np.cumsum([0, *(len(one.t_k) for one in every)], dtype=np.int64)
    result["stopped"] = np.array([one.stopped or "" for one in every])
    return result


def from_arrays(stored: Mapping[str, NDArray[Any]], document: Mapping[str, Any]) -> Run:
    """The run behind `arrays`, with the figures of its `simulation.json`.

    Raises:
        ArtefactError: arrays or a document that no run of this tool has.
    """
    try:
        return _read(stored, document)
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise ArtefactError(f"simulation.npz and simulation.json are not of one run: {error}; simulate again") from error


def _read(stored: Mapping[str, NDArray[Any]], document: Mapping[str, Any]) -> Run:
    fixed = {"t", "x", "t_k", "y_k", "offsets", "sample_offsets", "stopped"}
    names = [name for name in stored if name not in fixed]
    estimates = [name for name in names if not name.startswith(("input.", "internal."))]
    inputs = [name.removeprefix("input.") for name in names if name.startswith("input.")]
    internals = [name.removeprefix("internal.") for name in names if name.startswith("internal.")]
    trajectories = []
    for run in range(len(stored["offsets"]) - 1):
        on_grid = slice(int(stored["offsets"][run]), int(stored["offsets"][run + 1]))
        at_samples = slice(int(stored["sample_offsets"][run]), int(stored["sample_offsets"][run + 1]))
        trajectories.append(
            Trajectory(
                stored["t"][on_grid], stored["x"][on_grid], {name: stored[name][on_grid] for name in estimates},
                {name: stored[f"internal.{name}"][on_grid] for name in internals}, stored["t_k"][at_samples], stored["y_k"][at_samples],
                {name: stored[f"input.{name}"][on_grid] for name in inputs}, str(stored["stopped"][run]) or None,
            )
        )  # fmt: skip
    summaries = tuple(RunSummary(**summary) for summary in document["runs"])
    if len(summaries) != len(trajectories):
        raise ValueError("the numbers of runs differ")
    return Run(tuple(trajectories), summaries, RunSummary(**document["overall"]), document["digests"])


def to_bytes(run: Run) -> bytes:
    """`simulation.npz`; the same run gives the same bytes."""
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays(run))  # type: ignore[arg-type]
    return stream.getvalue()


def from_file(path: Path, document: Mapping[str, Any]) -> Run:
    """Raises: ArtefactError where the file is missing, damaged, or not of this document."""
    import zipfile

    try:
        with np.load(path, allow_pickle=False) as stored:
            content = {name: stored[name] for name in stored.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile) as error:
        raise ArtefactError(f"{path.name} cannot be read: {error}; simulate again") from error
    return from_arrays(content, document)
