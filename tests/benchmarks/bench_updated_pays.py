"""Does updating pay? Measurements against error for updated sampling, the best constant period, and the Kalman filter.

    python tests/benchmarks/bench_updated_pays.py [runs] [folder]

Prints each method's front and, at equal error, the measurements each needs; then the error against the level of the
noise, by alpha. Writes updating_pays.svg, .png, .csv.
"""

import sys
from pathlib import Path

import rooms  # noqa: F401 - opens the folders
from table import row
from updating import METHODS, Comparison, fewest, front

from cdobs_cli.chart import Chart, Panel, Series
from cdobs_cli.report.drawings import figure_files

ALPHAS = ("0.3", "0.6", "0.9", "1.2")
A_2S = ("0.05", "0.1", "0.2", "0.3", "0.5", "1")
PERIODS = ("0.05", "0.1", "0.15", "0.2", "0.25", "0.3", "0.4", "0.5", "0.6", "0.8", "1", "1.25")
RADII = (0.3, 0.5, 0.7, 0.8, 0.9)
NOISES = ("0.0001", "0.001", "0.01", "0.1")
QS = ("1e-8", "1e-5", "1e-3", "0.1")


def main(runs, folder):
    points = list(Comparison(runs, "30").points(ALPHAS, A_2S, PERIODS, RADII, QS))
    fronts = {method: front(points, method) for method in METHODS}
    for method, kept in fronts.items():
        print(f"\n{method}: measurements, error, settings")
        for point in kept:
            print(f"  {point.measurements:8.1f}  {point.error:.5f}  {point.settings}")
    print("\nmeasurements needed at equal error\n     error " + "".join(f"{method:>18}" for method in METHODS))
    for target in (point.error for point in fronts["updated"]):
        found = [fewest(points, method, target * (1 + 1e-9)) for method in METHODS]
        print(
            f"   {target:.5f} "
            + "".join(f"{point.measurements:18.1f}" if point else f"{'not reached':>18}" for point in found)
        )
    least = min(fronts["updated"], key=lambda point: point.error)
    for method in METHODS[1:3]:
        if point := fewest(points, method, least.error * (1 + 1e-9)):
            row(f"measurements at the least error of updated sampling / {method}", least.measurements,
                point.measurements, None, "")  # fmt: skip
    print(
        "\nerror of updated sampling by half width of the noise, a2 = 0.3\n     alpha "
        + "".join(f"{noise:>12}" for noise in NOISES)
    )
    for alpha in ALPHAS:
        errors = [Comparison(runs, "30", noise=noise).updated(alpha, "0.3").error for noise in NOISES]
        print(f"  {alpha:>8} " + "".join(f"{error:12.5f}" for error in errors))
    roles = dict(zip(METHODS, ("estimate", "measured", "other", "proved"), strict=True))
    series = tuple(
        Series(
            method,
            [p.measurements for p in kept],
            [p.error for p in kept],
            "points" if len(kept) == 1 else "line",
            roles[method],
        )
        for method, kept in fronts.items()
        if kept
    )
    panel = Panel("measurements a run", "error, root mean square", series, "log", "log")
    chart = Chart("updating_pays", "Measurements against error", "Fronts over the settings of each method.", (panel,))
    folder.mkdir(parents=True, exist_ok=True)
    for ending, content in figure_files(chart, ("svg", "png")).items():
        (folder / f"updating_pays.{ending}").write_bytes(content)


if __name__ == "__main__":
    main(
        int(sys.argv[1]) if len(sys.argv) > 1 else 24,
        Path(sys.argv[2]) if len(sys.argv) > 2 else Path("results/benchmarks"),
    )
