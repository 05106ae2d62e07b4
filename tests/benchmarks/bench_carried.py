"""Does a carried certificate pay? Measurements against error on three plants, over at least 64 runs from one seed.

    python tests/benchmarks/bench_carried.py [runs] [folder]

Beside it: Theorem 2', a constant period whose gain is proved by the clock certificate, the Kalman filter at the same
instants and at a constant period, and the observer of the theorems with numbers tuned by hand (met by no theorem).
Each method is run over a grid of its own settings; its front is the fewest measurements for each error. Prints the
fronts with the worst run, and what each needs at equal error; writes carried_<plant>.svg, .png, .csv. Ten minutes.
"""

import sys
from itertools import product
from pathlib import Path

import rooms  # noqa: F401 - opens the folders
from table import row
from updating import SPEC, Comparison, fewest, front

from cdobs_cli.chart import Chart, Panel, Series
from cdobs_cli.report.drawings import figure_files

PLANTS = {
    "bursts": SPEC,
    "switched": Path(__file__).parent / "plants" / "two_states.yaml",
    "three states": Path(__file__).parent / "plants" / "three_states.yaml",
}
ROLES = {
    "carried": "estimate", "updated, proved": "proved", "constant, clock": "measured", "hand-tuned": "other",
    "Kalman filter, same instants": "arrived", "Kalman filter": "beside",
}  # fmt: skip
WANTED = 0.0105  # the error on the first plant, at which carried certificates should need at most so many samples:
AT_MOST = 50
SPREAD = 1.5  # the worst run against the mean
TIMES = (0.2, 0.3, 0.34, 0.45, 0.6, 0.75)  # shares of the longest T_min
SHARES = ("1", "0.5", "0.25", "0.15")  # of the largest floor
SIGMAS = (0.02, 0.1)  # times 1 / T
THETA = "0.1"
QS = ("1e-8", "1e-6", "1e-4", "1e-2")


def carried(comparison, path):
    """Points with their observers: at shares of the longest T_min, with floors that ask for more or fewer samples."""
    found = comparison.carried(objective="max_period")
    assert found is not None, path
    longest = float(found[0].settings.split()[1].rstrip(",")) / 0.9
    for time, share, sigma in product(TIMES, SHARES, SIGMAS):
        T = round(time * longest, 3)
        law = {"T_min": str(T), "share": share, "theta": THETA, "idle": "0.1", "sigma": f"{sigma / T:.6g}"}
        yield comparison.carried(law=law)


def points(comparison, path):
    """All methods on one plant."""
    made = [one for one in carried(comparison, path) if one is not None]
    kept = front([point for point, _ in made], "carried")
    yield from (point for point, _ in made)
    yield comparison.proved()
    observers = {point.settings: observer for point, observer in made}
    for point in kept[:6]:
        yield from (comparison.kalman_at_the_same(observers[point.settings], q) for q in QS[:3])
    mean = 30 / kept[0].measurements
    periods = [f"{mean * share:.3g}" for share in (0.3, 0.45, 0.65, 1, 1.4)]
    yield from (comparison.kalman(period, q) for period in periods for q in QS)
    proved = (comparison.clocked(f"{mean * share:.3g}") for share in (0.12, 0.2, 0.3, 0.4, 0.5, 0.6))
    yield from (point for point in proved if point is not None)
    for alpha, a_2, radius in product(("0.5", "0.9", "1.3"), ("0.1", "0.3", "1"), (0.4, 0.6)):
        yield comparison.tuned(alpha, "0.3", a_2, radius)


def main(runs, folder):
    folder.mkdir(parents=True, exist_ok=True)
    for name, path in PLANTS.items():
        made = list(points(Comparison(runs, "30", path=path), path))
        fronts = {method: front(made, method) for method in ROLES}
        print(f"\n{name}: {runs} runs of 30")
        for method, kept in fronts.items():
            print(f"  {method}: measurements, error, worst run, settings")
            for point in kept:
                print(f"    {point.measurements:8.1f}  {point.error:.5f}  {point.worst:.5f}  {point.settings}")
        told(name, made, fronts)
        drawn(name, fronts, folder)


def told(name, made, fronts):
    """What each needs at the errors of the carried front, and the figures that are wanted."""
    print("  measurements at equal error\n     error " + "".join(f"{method:>30}" for method in ROLES))
    for target in (point.error for point in fronts["carried"]):
        found = [fewest(made, method, target * (1 + 1e-9)) for method in ROLES]
        numbers = "".join(f"{one.measurements:30.1f}" if one else f"{'not reached':>30}" for one in found)
        print(f"   {target:.5f} {numbers}")
    if name != "bursts":
        return
    point = fewest(made, "carried", WANTED)
    assert point is not None, "no carried certificate reaches the error that is wanted"
    row(f"measurements at error {WANTED:g}, carried / wanted", point.measurements, AT_MOST, 1, "")
    row("its worst run / all runs", point.worst, point.error, SPREAD, "")
    rival = fewest(made, "Kalman filter", point.error)
    if rival is not None:
        row("measurements at that error, carried / Kalman filter", point.measurements, rival.measurements, None, "")


def drawn(name, fronts, folder):
    series = tuple(
        Series(
            method, [p.measurements for p in kept], [p.error for p in kept], "points" if len(kept) == 1 else "line",
            ROLES[method],
        )
        for method, kept in fronts.items()
        if kept
    )  # fmt: skip
    stem = f"carried_{name.replace(' ', '_')}"
    panel = Panel("measurements a run", "error, root mean square", series, "log", "log")
    chart = Chart(stem, "Measurements against error", "Fronts over the settings of each method.", (panel,))
    for ending, content in figure_files(chart, ("svg", "png")).items():
        (folder / f"{stem}.{ending}").write_bytes(content)
    lines = ["method,measurements,error,worst,settings"]
    lines += [
        f'"{p.method}",{p.measurements},{p.error},{p.worst},"{p.settings}"' for kept in fronts.values() for p in kept
    ]
    (folder / f"{stem}.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(
        int(sys.argv[1]) if len(sys.argv) > 1 else 64,
        Path(sys.argv[2]) if len(sys.argv) > 2 else Path("results/benchmarks"),
    )
