"""The design as data: JSON with every decimal, and a MATLAB file of its matrices."""

from __future__ import annotations

import io
import json
from dataclasses import asdict
from typing import Any

import numpy as np

from cdobs_cli.certificate import Check
from cdobs_cli.design import Design
from cdobs_cli.export.about import About
from cdobs_cli.export.portable import Portable
from cdobs_cli.export.vectors import Vectors
from cdobs_cli.plant import Plant

_HEAD = 116  # bytes of text at the start of a MATLAB file: scipy tells the time there


def json_text(
    portable: Portable, about: About, told: Vectors | None, plant: Plant, design: Design, check: Check
) -> str:
    """Gain and plant as exact decimals, equations as text, the scheme, what is proved, and calls to test with."""
    document = {
        "schema_version": 1, "name": portable.name, "title": about.title, "verdict": about.verdict,
        "told": list(about.told), "digests": dict(about.digests), "family": design.family,
        "sampling": design.sampling.document(), "gain": {name: M.texts() for name, M in design.gain.items()},
        "plant": _plant(plant), "observer": _observer(portable), "time_unit": about.labels.time,
        "step": about.step, "accuracy": about.accuracy,
        "bounds": {name: bound.document() for name, bound in check.bounds.items()},
        "vectors": None if told is None else asdict(told),
    }  # fmt: skip
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _plant(plant: Plant) -> dict[str, Any]:
    h = None if plant.h is None else [str(row) for row in plant.h]
    return {
        "states": list(plant.states), "inputs": [one.name for one in plant.inputs], "A": plant.A.texts(),
        "B": None if plant.B is None else plant.B.texts(), "C": plant.C.texts(),
        "phi": [str(row) for row in plant.phi], "h": h, "domain": plant.domain.text,
        "slopes": {"lower": plant.slopes.lower.texts(), "upper": plant.slopes.upper.texts()},
    }  # fmt: skip


def _observer(portable: Portable) -> dict[str, Any]:
    """Expressions over the observer's states, the inputs, and `y.0`, ..; in `start` over `initial.<state>`, or
    `lower.<state>` and `upper.<state>`."""
    corrections = [
        {
            "sensors": list(one.sensors),
            "outputs": list(one.outputs),
            "jumps": [list(map(str, jump)) for jump in one.jumps],
        }
        for one in portable.corrections
    ]
    late = portable.late
    return {
        "states": list(portable.states), "start": list(map(str, portable.start)),
        "flow": list(map(str, portable.flow)), "corrections": corrections,
        "estimates": {name: list(map(str, rows)) for name, rows in portable.estimates.items()},
        "original": {name: str(row) for name, row in portable.original.items()},
        "control": {name: str(row) for name, row in portable.control.items()},
        "trigger": None if portable.trigger is None else str(portable.trigger),
        "sends": {name: str(row) for name, _, row in portable.compares},
        "stops": [{"condition": str(row), "sentence": sentence} for row, sentence in portable.stops],
        "first_sample": portable.first_sample,
        "schedule": None if portable.schedule is None else asdict(portable.schedule),
        "late": None if late is None else {
            "sensors": {name: list(outputs) for name, outputs in late.sensors},
            "expected": list(map(str, late.expected)), "samples": [list(map(str, jump)) for jump in late.samples],
        },
    }  # fmt: skip


def mat_bytes(portable: Portable, about: About, plant: Plant, design: Design) -> bytes:
    """A MATLAB 5 file: gains by their letters, of sensors with readings of their own also (n, p, readings) with 0 for
    outputs that are not read; A, B, C, slopes, the law's times, and text."""
    from scipy.io import savemat

    law = design.sampling
    content: dict[str, Any] = {name: M.floats for name, M in design.gain.items()}
    if law.has_sensors:
        for name, M in design.gain.items():
            content[f"{name}_readings"] = np.stack([one.floats for one in law.split(M, plant.p)], axis=2)
        content["readings"] = np.array([one.name for one in law.readings], dtype=object)
    content |= {
        "A": plant.A.floats, "C": plant.C.floats, "slopes_lower": plant.slopes.lower.floats,
        "slopes_upper": plant.slopes.upper.floats, "T_min": float(law.T_min), "T_max": float(law.T_max),
        "phi": np.array([str(row) for row in plant.phi], dtype=object),
        "states": np.array(plant.states, dtype=object), "law": about.law, "family": design.family,
        "title": about.title, "verdict": about.verdict, "time_unit": about.labels.time,
        "about": "\n".join(about.lines(portable, ())),
    }  # fmt: skip
    if plant.B is not None:
        content["B"] = plant.B.floats
    stream = io.BytesIO()
    savemat(stream, content)  # type: ignore[arg-type] # a stream will do
    head = f"MATLAB 5.0 MAT-file, {portable.name}, exported by cdobs".encode("ascii", "replace")
    return head[:_HEAD].ljust(_HEAD) + stream.getvalue()[_HEAD:]
