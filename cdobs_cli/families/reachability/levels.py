"""Level sets of the observer's error, from the clock-dependent certificates of a design."""

from __future__ import annotations

from dataclasses import replace

from cdobs_cli.certify.levels import Level, clock_level
from cdobs_cli.design import Design
from cdobs_cli.families.reachability.observer import inclusion
from cdobs_cli.plant import Plant


def levels(plant: Plant, design: Design) -> tuple[Level, ...]:
    """One for each clock certificate of the design's own gain and law."""
    closed = inclusion(replace(plant, sampling=design.sampling), design.gain)
    own = [c for c in design.certificates if c.sampling == design.sampling and "K" not in c.data]
    found = (clock_level(closed, certificate) for certificate in own)
    return tuple(level for level in found if level is not None)
