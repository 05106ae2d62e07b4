"""Time of the hybrid simulation against scipy's, segment by segment at equal tolerances, and of many runs.

    python tests/benchmarks/bench_simulation.py

Every ratio is measured in this one process, in CPU time. `simulate` includes compiling the equations and about 2000
output points; scipy (DOP853, one solve_ivp a segment, the same compiled flow) is timed without output and with as many
points.
"""

import time

import numpy as np
import rooms  # noqa: F401 - opens the folders
from loops import box, copy_observer, pendulum, periodic, plan, plant
from scipy.integrate import solve_ivp
from table import row

from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.simulate.dormand_prince import ATOL, RTOL
from cdobs_cli.simulate.engine import simulate

HORIZON = 20


def best(function, repeats=7):
    times = []
    for _ in range(repeats):
        start = time.process_time()
        result = function()
        times.append(time.process_time() - start)
    return min(times), result


def chain(n, period):
    """n states in a chain closed by a linear row and a sine: the system and its gains."""
    A = [[int(j == i + 1) for j in range(n)] for i in range(n)]
    A[n - 1] = [-(k + 1) for k in range(n)]
    gains = [str(1 / (i + 1)) for i in range(n)]
    model = plant([f"x{i}" for i in range(n)], A, ["0"] * (n - 1) + ["0.5*sin(x0)"], law=periodic(period))
    return copy_observer(model, gains), gains


class Comparison:
    def __init__(self, name, system, gains, period):
        self.name, self.system, self.period = name, system, float(period)
        self.gains, self.n = np.array(gains, dtype=float), system.plant.n
        values = compile_floats(system.flow, ("t", *system.states), arrays=False)
        self.flow = lambda t, z: values(t, *z)

    def ours(self):
        start = [1] + [0] * (self.n - 1)
        return simulate(self.system, plan(str(HORIZON), start, [0] * self.n), self.system.plant.sampling)

    def scipy(self, points):
        n, z = self.n, np.array([1.0] + [0.0] * (2 * self.n - 1))
        for k in range(int(HORIZON / self.period + 1e-9) + 1):
            z[n:] += self.gains * (z[0] - z[n])
            ends = (k * self.period, min((k + 1) * self.period, HORIZON))
            if ends[1] > ends[0]:
                t_eval = np.linspace(*ends, max(2, int(points * self.period / HORIZON))) if points else None
                z = solve_ivp(self.flow, ends, z, method="DOP853", rtol=RTOL, atol=ATOL, t_eval=t_eval).y[:, -1].copy()
        return z

    def row(self):
        ours, run = best(self.ours)
        plain, z = best(lambda: self.scipy(0))
        dense, _ = best(lambda: self.scipy(2000))
        self.ratio = ours, dense
        difference = np.abs(run.trajectories[0].x[-1] - z[: self.n]).max()
        return (
            f"{self.name:24} {self.period:6} {1e3 * ours:9.1f} {1e3 * plain:9.1f} {1e3 * dense:9.1f}"
            f" {plain / ours:9.2f} {dense / ours:9.2f} {difference:9.1e}"
        )


def stiff():
    """A rate of 1e6 beside one of 1: found stiff, then implicit."""
    model = plant(("a", "b"), [["-1", 0], ["1e6", "-1e6"]], C=[[1, 0]], law=periodic("1"))
    loop = Comparison("stiff", copy_observer(model, ["0.5", "0"]), ["0.5", "0"], "1")
    ours, _ = best(loop.ours, 3)
    flow = loop.flow

    def radau():
        z = np.array([1.0, 0.0, 0.0, 0.0])
        for k in range(HORIZON):
            z[2] += 0.5 * (z[0] - z[2])
            ends = (k, k + 1)
            z = solve_ivp(flow, ends, z, "Radau", np.linspace(*ends, 100), rtol=1e-9, atol=1e-10).y[:, -1].copy()

    # Scipy's own looks at no step, and is told from the start that the flow is stiff.
    row("simulation, rates 1 and 1e6 / scipy's Radau", ours, best(radau, 3)[0], 1.5)


def main():
    print(f"rtol {RTOL:g}, atol {ATOL:g} (ours: of the size of the state), horizon {HORIZON}; milliseconds, best of 7")
    print("loop                     period  simulate     scipy  scipy+out     ratio  ratio+out  |dx(end)|")
    gains = ["1", "1.8361"]
    loops = [Comparison("pendulum, 2 + 2 states", pendulum(gains, period), gains, period) for period in ("0.6", "0.05")]
    loops += [Comparison(f"chain, {n} + {n} states", *chain(n, "0.5"), "0.5") for n in (4, 8)]
    for loop in loops:
        print(loop.row())
    for loop in loops:
        row(f"simulation, {loop.name}, period {loop.period:g} / scipy", *loop.ratio, 1)
    stiff()
    system, starts = pendulum(), box([-1, -1], [1, 1])
    single, _ = best(lambda: simulate(system, plan(str(HORIZON), [1, 0], [0, 0]), system.plant.sampling))
    many, _ = best(
        lambda: simulate(
            system, plan(str(HORIZON), None, [0, 0], initial_box=starts, runs=1000), system.plant.sampling
        ),
        3,
    )
    row("simulation, 1000 runs of the pendulum / one by one", many, 1000 * single, 0.25)


if __name__ == "__main__":
    main()
