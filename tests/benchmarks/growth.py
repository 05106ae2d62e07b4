"""How work grows: CPU seconds and memory against states, corners and runs, as build/growth.csv and build/growth.svg.

    python tests/benchmarks/growth.py [--largest 8] [--folder build]

states: `synthesize` and `check` of the longest period by the clock certificate, of a chain of n states with one slope.
corners: the same at n = 4 with 1 to 4 slopes, which double the corners. LMIs are the calls of the solver, and the
inequalities of the flow that a certificate proves. loop, runs: a simulation of n + n states, and of many runs of a
pendulum, over 20 time units. Each point is measured in a process of its own, whose peak memory is ru_maxrss.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import rooms
from table import ONE_THREAD, cpu

STATES, SLOPES, RUNS = (2, 3, 4, 5, 6, 7, 8), (1, 2, 3, 4), (1, 3, 10, 30, 100, 300, 1000, 3000)
AT = 4  # states of the plants with several slopes


def certificate(states: int, slopes: int) -> dict[str, float]:
    from reachability_plants import symmetric_chain

    from cdobs_cli.certify.lmi import solver_log
    from cdobs_cli.families.reachability import Reachability

    plant = symmetric_chain((1,) * slopes + (0,) * (states - slopes), "0.3")
    family, made = Reachability(objective="max_period", method="clock"), []
    with solver_log() as calls:
        synthesize = cpu(lambda: made.append(family.synthesize(plant, 1)))
    design = made[0]
    check = cpu(lambda: made.append(family.certify(plant, design, 1)))
    assert made[1].verdict == "proved", made[1]
    return {"synthesize (s)": synthesize, "check (s)": check, "solver calls": len(calls), **proved(design, 2**slopes)}


def proved(design, corners: int) -> dict[str, float]:
    """The inequalities of the flow: one a corner, coefficient and piece of the clock certificate."""
    clock = next(certificate.data for certificate in design.certificates if certificate.method == "clock")
    return {"flow LMIs": sum(map(int, clock["pieces"])) * (int(clock["elevated"]) + 1) * corners}


def loop(states: int) -> dict[str, float]:
    """A cascade of decaying states closed by a sine: it stays small, so that steps hardly grow with n."""
    from loops import copy_observer, periodic, plan, plant

    from cdobs_cli.simulate.engine import simulate

    A = [[{0: -1, 1: 1}.get(j - i, 0) for j in range(states)] for i in range(states)]
    phi = [*["0"] * (states - 1), "0.5*sin(x0)"]
    model = plant([f"x{i}" for i in range(states)], A, phi, law=periodic("0.5"))
    system, rest = copy_observer(model, ["0.5"] * states), [0] * (states - 1)
    told = plan("20", [1, *rest], [0, *rest])
    return {"simulate (s)": cpu(lambda: simulate(system, told, model.sampling), 5)}


def runs(count: int) -> dict[str, float]:
    from loops import box, pendulum, plan

    from cdobs_cli.simulate.engine import simulate

    system, boxed = pendulum(), box([-1, -1], [1, 1])
    told = plan("20", None, [0, 0], initial_box=boxed, runs=count)
    return {"simulate (s)": cpu(lambda: simulate(system, told, system.plant.sampling), 3)}


STUDIES = {
    "states": lambda n: certificate(n, 1),
    "corners": lambda corners: certificate(AT, corners.bit_length() - 1),
    "loop": loop,
    "runs": runs,
}


def measured(study: str, x: int) -> dict[str, float]:
    """One point, in a process of its own."""
    command = [sys.executable, __file__, "--one", study, str(x)]
    done = subprocess.run(command, env=os.environ | ONE_THREAD, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def one(study: str, x: int) -> None:
    values = STUDIES[study](x)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps(values | {"peak memory (MB)": memory}))


def rows(largest: int) -> list[tuple[str, int, str, float]]:
    """(study, x, quantity, value) of every point."""
    asked = [("states", n) for n in STATES if n <= largest] + [("corners", 2**slopes) for slopes in SLOPES]
    asked += [("loop", n) for n in STATES if n <= largest] + [("runs", count) for count in RUNS]
    found = []
    for study, x in asked:
        values = measured(study, x)
        print(f"{study:<8} {x:>5}  " + "  ".join(f"{name} {value:.4g}" for name, value in values.items()), flush=True)
        found += [(study, x, name, value) for name, value in values.items()]
    return found


TITLES = {
    "states": "clock certificate, chain of n states, one slope",
    "corners": f"clock certificate, chain of {AT} states",
    "loop": "simulation, one run, n + n states",
    "runs": "simulation of a pendulum, many runs",
}
CERTIFICATE = (
    (("synthesize (s)", "check (s)"), "CPU (s)"),
    (("solver calls", "flow LMIs"), "LMIs"),
    (("peak memory (MB)",), "peak memory (MB)"),
)
SIMULATION = ((("simulate (s)",), "CPU (s)"), (("peak memory (MB)",), "peak memory (MB)"))
PANELS = (
    *(("states", *panel) for panel in CERTIFICATE),
    *(("corners", *panel) for panel in CERTIFICATE),
    ("loop", *SIMULATION[0]),
    *(("runs", *panel) for panel in SIMULATION),
)  # fmt: skip


def draw(found: Sequence[tuple[str, int, str, float]], path: Path) -> None:
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams.update({"font.size": 9, "axes.titlesize": 9, "svg.hashsalt": "growth"})
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(3, 3, figsize=(11, 9), layout="constrained")
    for ax, (study, names, y_label) in zip(axes.flat, PANELS, strict=True):
        for name, marker in zip(names, "os", strict=False):
            points = [(x, value) for of, x, what, value in found if (of, what) == (study, name)]
            ax.plot(*zip(*points, strict=True), marker=marker, markersize=4, label=name.removesuffix(" (s)"))
        scale(ax, study, sorted({x for of, x, *_ in found if of == study}), y_label)
        ax.set(title=TITLES[study], xlabel="states n" if study in ("states", "loop") else study, ylabel=y_label)
        ax.spines[["top", "right"]].set_visible(False)
        if len(names) > 1:
            ax.legend(frameon=False)
    figure.align_ylabels()
    figure.savefig(path, metadata={"Date": None})


def scale(ax, study: str, xs: Sequence[int], y_label: str) -> None:
    """Seconds on a logarithmic axis; counts and memory, of which most is there before any work, from 0."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    plain = FuncFormatter(lambda value, _: f"{value:g}")
    if y_label.startswith("CPU"):
        ax.set_yscale("log")
        ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        ax.yaxis.set_minor_locator(NullLocator())
        ax.yaxis.set_major_formatter(plain)
    else:
        ax.set_ylim(0, 1.15 * ax.dataLim.y1)
    ax.set_xscale("log" if study in ("corners", "runs") else "linear")
    ax.set_xticks(xs, [f"{x:g}" for x in xs])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.grid(alpha=0.3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--largest", type=int, default=8)
    parser.add_argument("--folder", type=Path, default=rooms.ROOT / "build")
    parser.add_argument("--one", nargs=2, metavar=("STUDY", "X"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        one(options.one[0], int(options.one[1]))
        return
    found = rows(options.largest)
    options.folder.mkdir(parents=True, exist_ok=True)
    with (options.folder / "growth.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([("study", "x", "quantity", "value"), *found])
    draw(found, options.folder / "growth.svg")


if __name__ == "__main__":
    main()
