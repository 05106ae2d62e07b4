"""A run as arrays, and as the bytes of `simulation.npz`.

Keys: t, x, one per estimate (x_hat, or x_lower and x_upper), t_k, y_k, `input.<name>`, `internal.<name>`; all runs one
after the other, run r in [offsets[r], offsets[r + 1]) of what is over t and [sample_offsets[r], sample_offsets[r + 1])
of t_k and y_k, and of arrival_k where they arrive late; `stopped`, one text a run, empty where none. y_k is NaN where
an output is not read; of sensors with periods of their own what each has read stands by itself too, `t_k.<sensor>`,
`y_k.<sensor>` and `sample_offsets.<sensor>`. Where a filter was run beside, `filter.t` and `filter.error`, its error
in run 0. Of many runs those that are shown stand there, and `bands.t` (G,), `bands.levels` (Q,), `bands.of.<state>`
(Q, G), percentiles of the errors of all.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.lib.format import read_array_header_1_0, read_array_header_2_0, read_magic
from numpy.typing import NDArray

from cdobs_cli.codec import read
from cdobs_cli.errors import ArtefactError
from cdobs_cli.run import Bands, Comparison, Ensemble, Filtered, Run, RunSummary, Trajectory
from cdobs_cli.sensors import Sensor

MAX_BYTES = 2**30
ARRIVAL = "arrival_k"
ON_GRID, AT_SAMPLES, PER_RUN = ("t", "x"), ("t_k", "y_k", ARRIVAL), ("offsets", "sample_offsets", "stopped")
OF_FILTER = ("filter.t", "filter.error")
OF_BANDS, OF_STATE = ("bands.t", "bands.levels"), "bands.of."
OF_SENSOR = ("t_k.", "y_k.", "sample_offsets.")


def arrays(run: Run, sensors: Sequence[Sensor] = ()) -> dict[str, NDArray[Any]]:
    """Every array of a run, by key; sensors: those that are not all read at each sample."""
    every = run.trajectories
    named = [
        {"t": one.t, "x": one.x, "t_k": one.t_k, "y_k": one.y_k, **one.estimates}
        | {f"input.{name}": values for name, values in one.inputs.items()}
        | {f"internal.{name}": values for name, values in one.internals.items()}
        | ({} if one.arrival_k is None else {ARRIVAL: one.arrival_k})
        for one in every
    ]
    together = {name: np.concatenate([own[name] for own in named]) for name in named[0]}
    beside = () if run.filtered is None else (run.filtered.t, run.filtered.error)
    bands: dict[str, NDArray[Any]] = {}
    if run.bands is not None:
        bands = dict(zip(OF_BANDS, (run.bands.t, np.array(run.bands.levels)), strict=True))
        bands |= {OF_STATE + name: values for name, values in run.bands.values.items()}
    return (
        together
        | dict(zip(OF_FILTER, beside, strict=False))
        | bands
        | {
            "offsets": np.cumsum([0, *(len(one.t) for one in every)], dtype=np.int64),
            "sample_offsets": np.cumsum([0, *(len(one.t_k) for one in every)], dtype=np.int64),
            "stopped": np.array([one.stopped or "" for one in every]),
        }
        | {key: array for sensor in sensors for key, array in _of_sensor(sensor, every).items()}
    )


def _of_sensor(sensor: Sensor, every: Sequence[Trajectory]) -> dict[str, NDArray[Any]]:
    """When a sensor was read, and what it said, all runs one after the other."""
    read_at = [one.read_by(sensor) for one in every]
    t_k, y_k = (np.concatenate(parts) for parts in zip(*read_at, strict=True))
    offsets = np.cumsum([0, *(len(t) for t, _ in read_at)], dtype=np.int64)
    return dict(zip((head + sensor.name for head in OF_SENSOR), (t_k, y_k, offsets), strict=True))


def to_bytes(run: Run, sensors: Sequence[Sensor] = ()) -> bytes:
    """`simulation.npz`; the same run gives the same bytes."""
    return packed(arrays(run, sensors))


def packed(content: Mapping[str, NDArray[Any]]) -> bytes:
    """The bytes of an .npz; the same arrays give the same bytes."""
    stream = io.BytesIO()
    np.savez_compressed(stream, **content)  # type: ignore[arg-type]
    return stream.getvalue()


def from_bytes(content: bytes, document: Mapping[str, Any]) -> Run:
    """The run behind `to_bytes`, with the figures of its `simulation.json`.

    Raises:
        ArtefactError: bytes or a document that no run of this tool has.
    """
    try:
        return _run(_unpacked(content), document)
    except Exception as error:  # damaged archives raise whatever zipfile, zlib, numpy and tokenize have
        text = f"simulation.npz and simulation.json are not of one run: {error}; simulate again"
        raise ArtefactError(text) from error


def _unpacked(content: bytes) -> dict[str, NDArray[Any]]:
    """Every array of an archive; nothing is set aside for what its headers only promise."""
    stored: dict[str, NDArray[Any]] = {}
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = archive.infolist()
        twice = len({member.filename for member in members}) < len(members)
        if twice or sum(member.file_size for member in members) > MAX_BYTES:
            raise ValueError("arrays that are too large or come twice")
        for member in members:
            stored[member.filename.removesuffix(".npy")] = _array(archive.read(member))
    return stored


def _array(content: bytes) -> NDArray[Any]:
    stream = io.BytesIO(content)
    read_header = {(1, 0): read_array_header_1_0, (2, 0): read_array_header_2_0}[read_magic(stream)]
    shape, by_columns, dtype = read_header(stream)
    size = math.prod(shape) * dtype.itemsize
    if dtype.kind not in "fiU" or size != len(content) - stream.tell():
        raise ValueError("an array that is not of the size or type that it says")
    if not size:
        return np.empty(shape, dtype)
    return np.frombuffer(content, dtype, offset=stream.tell()).reshape(shape, order="F" if by_columns else "C")


def _run(stored: Mapping[str, NDArray[Any]], document: Mapping[str, Any]) -> Run:
    known = (*ON_GRID, *AT_SAMPLES, *PER_RUN, *OF_FILTER, *OF_BANDS)
    names = [name for name in stored if name not in known and not name.startswith((OF_STATE, *OF_SENSOR))]
    estimates = [name for name in names if not name.startswith(("input.", "internal."))]
    inputs = [name.removeprefix("input.") for name in names if name.startswith("input.")]
    internals = [name.removeprefix("internal.") for name in names if name.startswith("internal.")]
    _refuse_misshapen(stored, estimates, names)
    trajectories = []
    for run in range(len(stored["offsets"]) - 1):
        on_grid = slice(int(stored["offsets"][run]), int(stored["offsets"][run + 1]))
        at_samples = slice(int(stored["sample_offsets"][run]), int(stored["sample_offsets"][run + 1]))
        shown = {name: stored[name][on_grid] for name in ("t", "x", *names)}
        trajectories.append(Trajectory(
            shown["t"], shown["x"], {name: shown[name] for name in estimates},
            {name: shown[f"internal.{name}"] for name in internals},
            stored["t_k"][at_samples], stored["y_k"][at_samples],
            {name: shown[f"input.{name}"] for name in inputs}, str(stored["stopped"][run]) or None,
            stored[ARRIVAL][at_samples] if ARRIVAL in stored else None,
        ))  # fmt: skip
    summaries = read(tuple[RunSummary, ...], document["runs"])
    many = None if "ensemble" not in document else read(Ensemble, document["ensemble"])
    kept = tuple(range(len(summaries))) if many is None else many.shown
    if len(trajectories) != len(kept) or any(not 0 <= number < len(summaries) for number in kept):
        raise ValueError("the numbers of runs differ")
    if many is not None and many != Ensemble.of(summaries, many.shown, many.worst):
        raise ValueError("what is said of all runs is not what each is")
    overall, digests = read(RunSummary, document["overall"]), read(dict[str, str], document["digests"])
    comparison = read(Comparison, document["comparison"]) if "comparison" in document else None
    implicit = read(int, document.get("implicit", 0))
    if not 0 <= implicit <= len(summaries):
        raise ValueError("more implicit runs than there are runs")
    return Run(
        tuple(trajectories), summaries, overall, digests, comparison, _filtered(stored), implicit=implicit,
        ensemble=many, bands=_bands(stored),
    )  # fmt: skip


def _bands(stored: Mapping[str, NDArray[Any]]) -> Bands | None:
    """Raises: KeyError, ValueError for arrays that do not fit together."""
    values = {name.removeprefix(OF_STATE): rows for name, rows in stored.items() if name.startswith(OF_STATE)}
    if not values and not any(name in stored for name in OF_BANDS):
        return None
    t, levels = (stored[name] for name in OF_BANDS)
    wrong = [rows for rows in values.values() if rows.shape != (len(levels), len(t)) or rows.dtype != np.dtype(float)]
    if wrong or {t.dtype, levels.dtype} != {np.dtype(float)}:
        raise ValueError("percentiles that are not one number a level and time")
    if not np.all(np.isfinite(t)) or any(
        np.isnan(rows).any() or np.any(rows[1:] < rows[:-1]) for rows in values.values()
    ):
        raise ValueError("percentiles that fall")
    return Bands(t, tuple(levels.tolist()), values)


def _filtered(stored: Mapping[str, NDArray[Any]]) -> Filtered | None:
    """Raises: KeyError, ValueError for arrays that do not fit together."""
    if not any(name in stored for name in OF_FILTER):
        return None
    t, error = (stored[name] for name in OF_FILTER)
    shapes = t.shape, error.shape
    if (
        shapes != ((len(t),), (len(t), stored["x"].shape[1]))
        or len(t) < 2
        or {t.dtype, error.dtype} != {np.dtype(float)}
    ):
        raise ValueError("the error of a filter that is not one number a state and time")
    if not np.all(np.isfinite(t)):
        raise ValueError("times that are not finite")
    return Filtered(t, error)


def _refuse_misshapen(stored: Mapping[str, NDArray[Any]], estimates: list[str], others: list[str]) -> None:
    """Raises: ValueError, KeyError, IndexError for arrays that do not fit together."""
    # A run may end before any sensor has sent.
    counts = (stored["offsets"], len(stored["t"]), 1), (stored["sample_offsets"], len(stored["t_k"]), 0)
    for offsets, length, least in counts:
        known = offsets.dtype == np.int64 and offsets[0] == 0 and offsets[-1] == length
        if not known or not np.all(np.diff(offsets) >= least):
            raise ValueError("runs that are not one after the other")
    n, p = stored["x"].shape[1], stored["y_k"].shape[1]
    N, K = len(stored["t"]), len(stored["t_k"])
    shapes = {"t": (N,), "x": (N, n), "t_k": (K,), "y_k": (K, p)}
    shapes |= {ARRIVAL: (K, p)} if ARRIVAL in stored else {}
    shapes |= {name: (N, n) if name in estimates else (N,) for name in others}
    if any(stored[name].shape != shape or stored[name].dtype != np.float64 for name, shape in shapes.items()):
        raise ValueError("arrays of unequal lengths or types")
    if not all(np.all(np.isfinite(stored[name])) for name in ("t", "t_k")):
        raise ValueError("times that are not finite")
    runs = stored["offsets"].shape
    if stored["sample_offsets"].shape != runs or stored["stopped"].shape != (runs[0] - 1,):
        raise ValueError("the numbers of runs differ")
