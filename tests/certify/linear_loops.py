"""Seeded random linear loops of two states whose error decays at short periods, and brute force against proofs."""

import numpy as np
from example_inclusions import held, impulsive, plant

from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.exact.numbers import Exact, decimal_text
from cdobs_cli.sampling import SamplingLaw

ZERO = [[0, 0], [0, 0]]
KINDS = ("impulsive", "held", "impulsive from 0")


def loops(count, seed):
    """(kind, at): `at(T)` is the loop under [T_min, T]; T_min = 0.1 for `impulsive`, else 0."""
    rng = np.random.default_rng(seed)
    made = []
    while len(made) < count:
        kind = KINDS[len(made) % 3]
        A = rng.standard_normal((2, 2))
        C = np.eye(2) if rng.random() < 0.25 else rng.standard_normal((1, 2))
        gain = rng.standard_normal((2, len(C))) * (1.5 if kind == "held" else 1)
        A, C, gain = ([[decimal_text(float(v), 3) for v in row] for row in M] for M in (A, C, gain))

        def at(T, A=A, C=C, gain=gain, kind=kind):
            law = SamplingLaw("aperiodic", Exact("0.1" if kind == "impulsive" else "0"), Exact(str(T)))
            return (held if kind == "held" else impulsive)(plant(A, ZERO, ZERO, C, law), gain)

        maps = at("0.2").floats
        short = np.linspace(0.1 if kind == "impulsive" else 0.02, 0.2, 8)
        long = np.linspace(0.2, 6, 40)
        radii = [spectral_radii(maps.jump @ exponentials(maps.base * s[:, None, None])) for s in (short, long)]
        if radii[0].max() < 1 < radii[1].max():
            made.append((kind, at))
    return made


def largest_product(inclusion, rng, words=400, longest=40):
    """The largest spectral radius of products of random periods of the law, most at its ends."""
    maps, law = inclusion.floats, inclusion.sampling
    low, high = float(law.T_min), float(law.T_max)
    total = np.broadcast_to(np.eye(len(maps.base)), (words, *maps.base.shape))
    largest = 0.0
    for _ in range(longest):
        shares = rng.random(words)
        shares = np.where(rng.random(words) < 0.6, np.round(shares), shares)
        periods = low + (high - low) * np.maximum(shares, 1e-3)
        total = maps.jump @ exponentials(maps.base * periods[:, None, None]) @ total
        largest = max(largest, float(spectral_radii(total).max()))
    return largest
