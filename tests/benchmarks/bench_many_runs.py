"""Many runs of the pendulum with jumps (period 0.6, horizon 40) against SciPy, against C written for this one loop, and
with instants that the observer chooses; memory as their number grows.

    python tests/benchmarks/bench_many_runs.py

SciPy's best at equal error (the least CPU of its methods whose final error is no larger), segment by segment, times the
number of runs. Ours are whole ensembles: draws, integration, figures of every run, percentiles, trajectories shown.
"""

import ctypes
import math
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import rooms
from loops import box, pendulum, plan
from scipy.integrate import solve_ivp
from table import ONE_THREAD, cpu, row
from test_compiled import triggered

from cdobs_cli.codegen import prelude
from cdobs_cli.library import library
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate import ensemble as ensembles
from cdobs_cli.simulate.compiled import _step
from cdobs_cli.simulate.engine import simulate
from cdobs_cli.simulate.ensemble import Parts, ensemble

RUNS, HORIZON, T, GAINS = 1000, 40.0, 0.6, np.array([1.0, 1.8361])


def flow(t, z):
    return (z[1], math.sin(z[0]), z[3], math.sin(z[2]))


def by_scipy(method, tolerance, start=(1.0, 0.0)):
    z = np.array([*start, 0.0, 0.0])
    for k in range(int(HORIZON / T + 1e-9) + 1):
        z[2:] += GAINS * (z[0] - z[2])
        end = min((k + 1) * T, HORIZON)
        if end > k * T:
            z = solve_ivp(flow, (k * T, end), z, method=method, rtol=tolerance, atol=tolerance / 10).y[:, -1].copy()
    return z


def scipys_best():
    """CPU seconds of one run, at our error or less."""
    exact = by_scipy("DOP853", 3e-14)
    alone = simulate(pendulum(), plan("40", [1, 0], [0, 0]), pendulum().plant.sampling).trajectories[0]
    allowed = 2 * np.abs(alone.x[-1] - exact[:2]).max()
    times = {}
    for method in ("DOP853", "LSODA", "RK45", "Radau"):
        for tolerance in (1e-9, 1e-10, 1e-11, 1e-12, 1e-13):
            if method in ("RK45", "Radau") and tolerance < 1e-11:
                continue
            if np.abs(by_scipy(method, tolerance)[:2] - exact[:2]).max() <= allowed:
                times[method, tolerance] = cpu(lambda m=method, e=tolerance: by_scipy(m, e), 3)
                break
    best = min(times, key=times.__getitem__)
    print(f"SciPy's best: {best[0]}, tolerance {best[1]:g}")
    return times[best]


def ours(system=None, law=None, runs=RUNS, horizon="40"):
    system = system or pendulum()
    asked = plan(horizon, None, [0, 0], initial_box=box([-1, -1], [1, 1]), runs=runs)
    with tempfile.TemporaryDirectory() as folder:
        return ensemble(system, asked, law or system.plant.sampling, Parts(Path(folder), {}))


def over_arrays(work):
    """What it takes without machine code."""
    compiled, ensembles._compiled = ensembles._compiled, lambda *loop: None
    try:
        return cpu(work, 2)
    finally:
        ensembles._compiled = compiled


BY_HAND = """
static void flow(double t, const double *y, const double *held, double *out)
{ out[0] = y[1]; out[1] = sin(y[0]); out[2] = y[3]; out[3] = sin(y[2]); }
"""
LOOP = """
#include <string.h>
void all(const double *starts, long runs, double horizon, double T, double *ends)
{
    for (long r = 0; r < runs; r++) {
        double y[4] = {starts[2 * r], starts[2 * r + 1], 0, 0}, z[4], k[13][4], low[4] = {1e-12, 1e-12, 1e-12, 1e-12};
        double h = 1e-3, t = 0, error, held[1] = {0};
        for (long n = 0; t < horizon; n++) {
            double e = y[0] - y[2], end = (n + 1) * T < horizon ? (n + 1) * T : horizon;
            y[2] += 1.0 * e;
            y[3] += 1.8361 * e;
            flow(t, y, held, k[0]);
            while (t < end) {
                double left = end - t, d = h >= left ? left : 2 * h > left ? left / 2 : h;
                step(t, d, y, held, low, k, z, &error);
                double factor = error < 1e-6 ? 6 : 0.9 * pow(error, -0.125);
                factor = factor > 6 ? 6 : factor < 0.2 ? 0.2 : factor;
                if (error > 1) { h = d * factor; continue; }
                h = d < h && h > d * factor ? h : d * factor;
                t = d == left ? end : t + d;
                memcpy(y, z, sizeof y);
                memcpy(k[0], k[12], sizeof z);
            }
        }
        memcpy(ends + 4 * r, y, sizeof y);
    }
}
"""


def by_hand():
    """CPU seconds of a scalar C loop for this plant, this observer and this law, which keeps the final states alone."""
    code = f"#define SIZE 4\n#define RTOL 1e-11\n{BY_HAND}{_step()}{LOOP}"
    made = library(prelude(code) + code)
    starts, ends = np.random.default_rng(0).uniform(-1, 1, (RUNS, 2)), np.empty((RUNS, 4))
    pointers = [ctypes.c_void_p(one.ctypes.data) for one in (starts, ends)]
    numbers = ctypes.c_long(RUNS), ctypes.c_double(HORIZON), ctypes.c_double(T)
    return cpu(lambda: made[0].all(pointers[0], *numbers, pointers[1]), 5)


def machine_code_alone():
    """CPU seconds inside of the library, of all that `ours` takes."""
    from cdobs_cli.simulate import compiled

    seconds, call = [], compiled.Compiled._call

    def timed(self, *arguments):
        out = []
        seconds.append(cpu(lambda: out.append(call(self, *arguments))))
        return out[0]

    compiled.Compiled._call = timed
    try:
        totals = []
        for _ in range(4):
            seconds.clear()
            ours()
            totals.append(sum(seconds))
        return min(totals)
    finally:
        compiled.Compiled._call = call


def event_by_scipy():
    """A run of the observer that chooses its samples, by solve_ivp's events, one segment after the other."""
    z, t = np.array([1.0, 0.0, 0.0, 0.0]), 0.0
    while t < HORIZON:
        z[2:] += GAINS * (z[0] - z[2])

        def due(s, x, since=t):
            return s - since - 0.3 - 0.1 * math.sin(x[2])

        due.terminal, due.direction = True, 1
        made = solve_ivp(flow, (t, HORIZON), z, method="DOP853", rtol=1e-11, atol=1e-12, events=due)
        t, z = made.t[-1], made.y[:, -1].copy()


def peak_memory(runs):
    """MB of a process that simulates so many runs."""
    code = f"import bench_many_runs as b, resource; b.ours(runs={runs}, horizon='20')\n"
    code += "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
    environment = {"PATH": "/usr/bin:/bin", **ONE_THREAD, "PYTHONPATH": f"{Path(__file__).parent}:{rooms.ROOT}"}
    told = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    return float(told.stdout)


def main():
    one = scipys_best()
    reference = RUNS * one
    ours()  # compiled and looked at
    row("1000 runs, arrays / scipy's best at equal error", over_arrays(ours), reference, 1 / 75)
    row("1000 runs, machine code / scipy's best", cpu(ours, 5), reference, 1 / 75)
    row("1000 runs, inside of the library / C for this loop", machine_code_alone(), by_hand(), 1.3)
    law, system = SamplingLaw("updated"), triggered()
    ours(system, law)
    events = RUNS * cpu(event_by_scipy, 3)
    row(
        "1000 runs with trigger events, machine code / scipy's events",
        cpu(lambda: ours(system, law), 3),
        events,
        1 / 120,
    )
    row("1000 runs with trigger events, arrays / scipy's events", over_arrays(lambda: ours(system, law)), events)
    row(
        "one run / scipy's best",
        cpu(lambda: simulate(pendulum(), plan("40", [1, 0], [0, 0]), pendulum().plant.sampling), 7),
        one,
        1,
    )
    least, most = (peak_memory(runs) for runs in (1000, 20_000))
    row("peak memory, 20000 runs / 1000 runs", most, least, 1.5, "MB")


if __name__ == "__main__":
    main()
