"""Objectives under noise: the gain of least proved error, an error to be kept, weights, the front of periods."""

from __future__ import annotations

from pathlib import Path

import pytest

from cdobs_cli.certificate import Check
from cdobs_cli.design import Design
from cdobs_cli.errors import SpecError
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.pipeline import Work, check
from cdobs_cli.report.front import knee
from cdobs_cli.spec.model import load
from cdobs_cli.store import Store

PENDULUM = """
spec_version: 1
plant:
  states: [theta, omega]
  A: [[0, 1], [0, 0]]
  phi: ["0", "sin(theta)"]
  lipschitz: [[0, 0], [1, 0]]
  {disturbance}
measurement: {{C: [[1, 0]], sampling: {law}{noise}}}
observer: {{family: {family}, {options}}}
"""
BOUNDED = {
    "disturbance": "disturbance: {lower: [0, -0.05], upper: [0, 0.05]}",
    "noise": "{lower: [-0.01], upper: [0.01]}",
}
WHITE = {"disturbance": "disturbance: {intensity: [[0, 0], [0, 2.5e-4]]}", "noise": '{covariance: [["1e-4/3"]]}'}


def designed(
    tmp_path: Path, law: str, options: str, *, family: str = "reachability", effort: int = 1, **signals: str
) -> tuple[Design, Check]:
    path = tmp_path / "spec.yaml"
    noise = f", noise: {signals['noise']}" if "noise" in signals else ""
    acting = signals.get("disturbance", "")
    path.write_text(PENDULUM.format(disturbance=acting, law=law, noise=noise, family=family, options=options))
    work = Work(load(path), Store(tmp_path / "results"), effort=effort)
    made = check(work)
    assert work.design is not None
    return work.design, made


def proved(made: Check, name: str) -> float:
    return float(made.bounds[name].proved or "inf")


@pytest.mark.parametrize(("T", "least"), [("0.1", 0.0625), ("0.6", 0.1025)])
def test_the_least_proved_error_of_the_pendulum(T: str, least: float, tmp_path: Path) -> None:
    """The figures of the theory of noise, for the weight on omega alone."""
    law = f"{{period: {T}}}"
    design, made = designed(tmp_path, law, "objective: min_error, weights: {omega: 1}", **BOUNDED)
    assert design.outcome == "found" and made.verdict == "proved"
    bound = made.bounds["error.omega"]
    assert proved(made, "error.omega") <= least and float(bound.refuted or 0) > 0.95 * least / 1.05
    assert made.claim("error_bounded") is not None and made.claim("error_bounded").status == "proved"  # type: ignore[union-attr]


def test_given_period_under_noise_is_least_error_and_without_it_the_quiet_gain(tmp_path: Path) -> None:
    noisy, of_noisy = designed(tmp_path, "{period: 0.1}", "objective: given_period", **BOUNDED)
    plain, _ = designed(tmp_path, "{period: 0.1}", "objective: given_period")
    assert float(noisy.gain["K"][1, 0]) < 2.5 < float(plain.gain["K"][1, 0]) < 10
    assert proved(of_noisy, "error.omega") < 0.07


def test_white_noise_is_weighed_in_mean_square(tmp_path: Path) -> None:
    options = "objective: min_error, weights: {theta: 1, omega: 1}"
    design, made = designed(tmp_path, "{period: 0.1}", options, **WHITE)
    assert proved(made, "rms") <= 0.0128
    assert [float(row[0]) for row in design.gain["K"].texts()] == pytest.approx([0.3604, 0.8002], abs=2e-3)


def test_bounded_and_white_signals_at_once(tmp_path: Path) -> None:
    """More than what white noise does alone, and about what superposition allows."""
    given = 'gain: {K: [["0.8"], ["1.5"]]}'
    both = {"disturbance": BOUNDED["disturbance"], "noise": "{std: [0.005]}"}
    _, mixed = designed(tmp_path, "{period: 0.3}", given, **both)
    _, peak = designed(tmp_path, "{period: 0.3}", given, disturbance=BOUNDED["disturbance"])
    _, white = designed(tmp_path, "{period: 0.3}", given, noise="{std: [0.005]}")
    assert mixed.verdict == "proved" and "error.omega" not in mixed.bounds
    for state in ("theta", "omega"):
        alone = proved(white, f"rms.{state}")
        assert alone < proved(mixed, f"rms.{state}") <= 1.2 * (proved(peak, f"error.{state}") + alone)
    squares = sum(proved(mixed, f"rms.{state}") ** 2 for state in ("theta", "omega"))
    assert proved(mixed, "rms") ** 2 <= squares * 1.0001


def test_the_longest_period_of_an_error(tmp_path: Path) -> None:
    options = "objective: max_period, rate_at_least: 0, error_at_most: {omega: 0.1}, weights: {omega: 1}"
    design, made = designed(tmp_path, "{period: 0.2}", options, effort=0, **BOUNDED)
    assert design.outcome == "found" and proved(made, "error.omega") <= 0.1
    assert 0.5 <= float(design.sampling.T_max) <= 0.62
    small = "objective: min_error, error_at_most: {omega: 0.05}, weights: {omega: 1}"
    short, below = designed(tmp_path, "{period: 0.2}", small, effort=0, **BOUNDED)
    assert short.outcome == "short" and short.reason is not None and "|e_omega| <= 0.05 was asked for" in short.reason
    assert below.verdict == "proved"


def test_the_front_is_a_running_best_for_laws_from_zero(tmp_path: Path) -> None:
    design, made = designed(tmp_path, "{max_period: 0.4}", "objective: min_error", **BOUNDED)
    assert made.verdict == "proved"
    periods = [float(Exact(point.period)) for point in design.front]
    assert periods == sorted(periods) and len(periods) >= 4 and all("K" in point.gain for point in design.front)
    errors = [float(point.error["theta"]) * float(point.error["omega"]) for point in design.front]
    assert errors == sorted(errors)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ("objective: min_error", "least error needs noise or a disturbance"),
        ("error_at_most: {omega: 1}", "an error under noise needs noise or a disturbance"),
    ],
)
def test_what_needs_noise_says_so(options: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(SpecError) as refused:
        designed(tmp_path, "{period: 0.1}", options)
    assert told in str(refused.value) and "declare measurement.noise" in str(refused.value)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ("error_at_most: {speed: 1}", "speed"), ("weights: {omega: -1}", "not negative"),
        ("weights: {omega: 0}", "one weight at least"), ("error_at_most: {omega: 0}", "positive"),
        ("objective: decay_rate, error_at_most: {omega: 1}", "fastest rate"),
        ("gain: {K: [[1], [1]]}, error_at_most: {omega: 1}", "expect"),
    ],
)  # fmt: skip
def test_wrong_options_are_refused(options: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(SpecError) as refused:
        designed(tmp_path, "{period: 0.1}", options, **BOUNDED)
    assert told in str(refused.value)


def test_the_knee_is_where_the_curve_bends() -> None:
    assert knee([1, 2, 3, 4, 5, 6], [1, 1.02, 1.05, 1.1, 3, 9]) == 3
    assert knee([1, 2, 3, 4], [1, 2, 3, 4]) is None and knee([1, 2], [1, 2]) is None
