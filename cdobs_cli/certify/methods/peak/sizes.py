"""How large errors become, in floats: the units of a search, and how fast a tail may shrink."""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.certify.methods.peak.signals import acting
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

_CORNERS = 64
_SLOTS = 6  # of a period: d switches between them
_SAMPLES = 400


@dataclass(frozen=True)
class Sizes:
    """What constant slopes do: radius the largest spectral radius of one period, rate the slowest decay rate per time,
    errors (N,) the largest |e_i| that unit signals make at some corner, 0 where none acts."""

    radius: float
    rate: float
    errors: Array


def float_signals(inclusion: HybridInclusion) -> tuple[Array, Array]:
    """B diag(d0), G diag(v0) without the columns of signals that are 0: for signals of size 1."""
    plant, maps, (d0, v0) = inclusion.plant, inclusion.noise_floats, signal_sizes(inclusion)
    return maps.drive[:, acting(plant.disturbance)] * d0, maps.kick[:, acting(plant.noise)] * v0


def signal_sizes(inclusion: HybridInclusion) -> tuple[Array, Array]:
    """d0 and v0 of the signals that are not 0."""
    boxes = (inclusion.plant.disturbance, inclusion.plant.noise)
    d0, v0 = (np.array([] if box is None else [box.float_sizes[j] for j in acting(box)]) for box in boxes)
    return d0, v0


def sizes(maps: ErrorMaps[Array], B: Array, G: Array, periods: list[float]) -> Sizes | None:
    """Over corners of flow and jump and the periods given; None where a number is not finite."""
    N, q = B.shape
    flows = np.array(list(islice(maps.corners(), _CORNERS)))
    jumps = list(islice(maps.jumps(), _CORNERS))
    augmented = np.zeros((len(flows), N + q, N + q))
    augmented[:, :N, :N], augmented[:, :N, N:] = flows, B
    radius, rate, errors = 0.0, np.inf, np.zeros(N)
    with np.errstate(all="ignore"):
        for T in periods:
            slot = exponentials(augmented * (T / _SLOTS))
            Phi, fed = slot[:, :N, :N], slot[:, :N, N:]
            steps, power = [], np.broadcast_to(np.eye(N), Phi.shape)
            for _ in range(_SLOTS):
                steps.append(power @ fed)  # the effect at the end of a period of d in one of its slots
                power = power @ Phi
            if not np.all(np.isfinite(power)):
                return None
            within = np.sum(np.abs(steps), axis=(0, 3))
            for J in jumps:
                largest = float(spectral_radii(J @ power).max())
                radius, rate = max(radius, largest), min(rate, -np.log(max(largest, 1e-12)) / T)
                if radius >= 1:
                    return Sizes(radius, rate, errors)
                errors = np.maximum(errors, _summed(power, J, np.array(steps), within, G))
    return Sizes(radius, rate, errors)


def _summed(power: Array, J: Array, steps: Array, within: Array, G: Array) -> Array:
    """The largest |e_i| just before and just after samples, over the corners."""
    inputs = np.concatenate([np.broadcast_to(G, (len(power), *G.shape)), *(J @ step for step in steps)], axis=-1)
    after = np.zeros(power.shape[:2])
    before = within.copy()
    for _ in range(_SAMPLES):
        after += np.abs(inputs).sum(axis=-1)
        flown = power @ inputs
        before += np.abs(flown).sum(axis=-1)
        inputs = J @ flown
        if np.abs(inputs).max(initial=0.0) < 1e-4 * after.max(initial=1e-300):
            break
    largest: Array = np.maximum(after, before).max(axis=0)
    return largest
