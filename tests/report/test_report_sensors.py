"""What a report, its figures and the archive of a run say of each sensor."""

from __future__ import annotations

import csv
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import made
from report_pendulum import make_design, make_report

from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.report.blocks import Bullets, Paragraph
from cdobs_cli.report.sensing import assumed
from cdobs_cli.sampling import SamplingLaw

# Two sensors of one state, and one of both states: 3 outputs, a pattern of 4 samples.
THREE = """\
spec_version: 1
plant: {states: [x, v], dynamics: [v, "-x"]}
measurement:
  sensors:
    cam: {output: [x], period: 0.4, noise: {lower: [-0.01], upper: [0.01]}}
    radar: {output: [2*x], period: 0.2, offset: 0.1}
    sum: {output: [x + v], period: 0.4, offset: 0.1, noise: {lower: [-0.02], upper: [0.03]}}
observer: {family: reachability}
simulation: {horizon: 2, initial_state: [1, 0], initial_estimate: [0, 0]}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sensors")
    result = made(path, THREE)
    assert result.status == "ok", result.messages
    return path / "out"


def test_the_report_says_what_is_assumed_of_each(folder: Path) -> None:
    text = (folder / "report.md").read_text()
    every = "no sample is lost, each is used when it is taken"
    for line in (
        f"cam (y1): read every 0.4 s, first at 0 s, exactly then; {every}; "
        r"noise that may be anything within v1 in \[-0.01, 0.01\] at each sample.",
        f"radar (y2): read every 0.2 s, first at 0.1 s, exactly then; {every}; ",
        r"sum (y3): read every 0.4 s, first at 0.1 s, exactly then; ",
        "The pattern of all samples repeats every 0.4 s. Each sample of the common pattern has a gain of its own.",
    ):
        assert line in text
    # 1 + 2 + 1 outputs are read in a pattern.
    rows = [line for line in text.splitlines() if line.startswith(("| 0 |", "| 0.1 |", "| 0.3 |"))]
    assert [row.split("|")[2].strip() for row in rows] == ["cam (y1)", "radar (y2)", "sum (y3)", "radar (y2)"]
    assert "At the first sample, of cam; at the others alike" in text


def test_the_archive_holds_what_each_has_read(folder: Path) -> None:
    with np.load(folder / "simulation.npz") as arrays:
        for name, k, times in (("cam", 0, (0, 0.4)), ("radar", 1, (0.1, 0.2)), ("sum", 2, (0.1, 0.4))):
            t, y = arrays[f"t_k.{name}"], arrays[f"y_k.{name}"]
            assert t == pytest.approx(times[0] + times[1] * np.arange(len(t))) and y.shape == (len(t), 1)
            assert arrays[f"sample_offsets.{name}"].tolist() == [0, len(t)]
            at = np.isin(arrays["t_k"], t)
            assert np.array_equal(arrays["y_k"][at, k], y[:, 0]) and np.isnan(arrays["y_k"][~at, k]).all()
            assert np.isfinite(y).all() and 5 <= len(t) <= 10


def test_figures_mark_the_samples_of_each(folder: Path) -> None:
    with (folder / "figures" / "states.csv").open() as file:
        drawn = Counter((row["quantity"], row["series"]) for row in csv.DictReader(file))
    with np.load(folder / "simulation.npz") as arrays:
        counts = {name: len(arrays[f"t_k.{name}"]) for name in ("cam", "radar", "sum")}
    assert drawn["$x$", "cam"] == counts["cam"] and drawn["$x$", "radar"] == counts["radar"]
    assert drawn["$y_{3}$", "sum"] == counts["sum"]
    picture = (folder / "figures" / "states.svg").read_text().lower()
    assert all(colour.lower() in picture for colour in ("#E69F00", "#CC79A7", "#56B4E9"))
    assert not (folder / "figures" / "sampling.svg").exists()


def told(law: SamplingLaw, **plant: object) -> str:
    made_of = make_report(design=replace(make_design(), sampling=law))
    report = replace(made_of, plant=replace(made_of.plant, **plant))
    return " ".join(
        " ".join(one.items) if isinstance(one, Bullets) else one.text
        for one in assumed(report)
        if isinstance(one, Bullets | Paragraph)
    )


@pytest.mark.parametrize(("law", "words"), [
    (SamplingLaw.periodic(Exact("0.5")), "read every 0.5 s, first at 0, exactly then; no sample is lost"),
    (SamplingLaw("aperiodic", Exact("0.1"), Exact("0.5")), "read at intervals anywhere in [0.1, 0.5] s, first at 0"),
    (SamplingLaw.periodic(Exact("0.5"), 2), "read every 0.5 s, of which at most 2 in a row are lost"),
    (SamplingLaw.randomly(Exact("0.5"), Exact("0.1")), "each lost with probability 0.1, independently"),
    (SamplingLaw("updated"), "read at instants that the observer chooses; no sample is lost"),
])  # fmt: skip
def test_one_sensor_is_told_too(law: SamplingLaw, words: str) -> None:
    text = told(law, noise=None)
    assert words in text and "no noise" in text
    assert text.count("no sample is lost") == (0 if law.is_lossy or law.is_random else 1)


def test_white_noise_is_told_with_its_variance() -> None:
    text = told(SamplingLaw.periodic(Exact("0.5")), noise=None, covariance=ExactMatrix([["0.04"]]))
    assert "white noise of mean 0, independent from sample to sample, of the variance 0.04 of v1" in text
