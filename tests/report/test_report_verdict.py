"""The verdict in plain words."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import pytest
from command import Job, made, run
from report_pendulum import make_check, make_design, make_report

from cdobs_cli.batch import Settings
from cdobs_cli.certificate import Bound
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.report.html import html_page
from cdobs_cli.report.summary import summary_lines
from cdobs_cli.report.verdict import duration, is_expected, verdict_text, words
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import Sensor


@pytest.mark.parametrize(("time", "unit", "text"), [
    ("0.02", "s", "20 ms"), ("0.6", "s", "0.6 s"), ("60", "s", "60 s"), ("300", "s", "5 min"), ("7200", "s", "2 h"),
    ("0.00003", "s", "30 µs"), ("0.0320651234567", "s", "32.0651234567 ms"), ("5", "min", "5 min"),
    ("0.02", "min", "0.02 min"), ("inf", "s", "∞ s"), ("1000000", "s", "1000000 s"),
])  # fmt: skip
def test_times_in_a_unit_that_suits_them(time: str, unit: str, text: str) -> None:
    assert duration(time, unit) == text


def test_rounded_to_the_safe_side() -> None:
    proved = Bound("0.0320699999999", "0.0321000000001", unit="s", better="more")
    close = Bound("0.35020966123", "0.35020966871", unit="s", better="more")
    (told,) = [line for line in words(make_report(check=with_period(proved))) if " proved is " in line]
    assert "proved is 32.0699 ms; at 32.1001 ms it fails" in told
    (told,) = [line for line in words(make_report(check=with_period(close))) if " proved is " in line]
    assert "proved is 0.3502096612 s; at 0.3502096688 s it fails" in told


def with_period(bound: Bound):
    check = make_check()
    return replace(check, bounds={"period_max": bound})


def test_what_is_proved_comes_first() -> None:
    report = make_report(check=make_check())
    first, second, *further = words(report)
    assert first.startswith("The estimate converges (to 1 % within ") and "if samples come every 0.6 s" in first
    assert second.startswith("The longest period proved is 1.713043 s; at 1.7131 s it fails")
    assert any(line.startswith("Assumed: the plant stays in") for line in further)
    assert summary_lines(report)[1].strip() == first
    assert f"<strong>{first}</strong>" in html_page(report, {chart.name: b"<svg ></svg>" for chart in report.charts})


def test_no_period_is_too_long() -> None:
    endless = make_report(check=with_period(Bound("inf", None, unit="s", better="more")))
    assert "No period is too long: the error decays by itself between samples." in words(endless)


def test_nothing_refuted_and_nothing_proved() -> None:
    (told,) = [one for one in words(make_report(check=with_period(Bound("2", None, unit="s")))) if " proved is " in one]
    assert told.endswith("proved is 2 s; none is known for which it fails.")
    (told,) = [one for one in words(make_report(check=with_period(Bound(None, "2", unit="s")))) if "No period" in one]
    assert told == "No period is proved; from 2 s on it fails."


def test_without_a_design_the_reason_is_the_verdict() -> None:
    none = Design("copying", "none", make_design().sampling, {}, reason="the pair (A, C) is not detectable")
    assert words(make_report(design=none)) == ("No observer was found: the pair (A, C) is not detectable.",)


def test_other_laws() -> None:
    def first(law: SamplingLaw) -> str:
        report = make_report(check=make_check(), design=replace(make_design(), sampling=law))
        return words(report)[0]

    sensors = [Sensor("a", (0,), Fraction(1)), Sensor("b", (1,), Fraction(2), Fraction(1, 2))]
    assert "with the sensors read as declared (a every 0.1 s, b every 0.2 s" in first(
        SamplingLaw.multirate(Exact("0.1"), sensors)
    )
    assert "if samples come at intervals anywhere in [0, 0.1] s" in first(
        SamplingLaw("aperiodic", Exact(0), Exact("0.1"))
    )
    assert " in mean square, and almost surely, if samples come every 0.3 s, each lost" in first(
        SamplingLaw.randomly(Exact("0.3"), Exact("0.1"))
    )
    assert "at the samples that the observer asks for" in first(SamplingLaw("updated"))


REFUTED = """\
spec_version: 1
plant: {states: [x], A: [[1]], phi: ["0"], lipschitz: [[0]]}
measurement: {C: [[1]], sampling: {period: 1}}
observer: {family: reachability, gain: {K: [[0.1]]}}
"""


def test_a_refutation_that_is_expected_is_told_so(tmp_path: Path) -> None:
    found = made(tmp_path, REFUTED, ("synthesize", "check", "report"))
    assert found.status == "finding" and found.summary[0].endswith(": refuted")
    assert "The estimate does not converge if samples come every 1 s" in found.summary[1]
    expected = made(tmp_path, REFUTED + "expect: [{quantity: verdict, equals: refuted}]\n", ("check", "report"))
    assert expected.status == "ok" and expected.summary[0].endswith(": refuted, as expected")
    assert 'class="headline expected"' in (tmp_path / "out" / "report.html").read_text()


def test_expected_is_only_what_was_expected() -> None:
    report = make_report(check=make_check())
    assert not is_expected(report) and verdict_text(report) == report.verdict


GIVEN = """\
spec_version: 1
plant: {states: [x1, x2], A: [[0, 1], [0, 0]], phi: ["0", "sin(x1)"], lipschitz: [[0, 0], [1, 0]]}
measurement: {C: [[1, 0]], sampling: {period: 0.5}}
observer: {family: reachability, gain: {K: [[1], [1.8361]]}}
"""


def test_the_end_that_fails_is_replayed_where_it_is_said_so(tmp_path: Path) -> None:
    """Between samples just above the exact limit of this gain, 0.96043, some error no longer decays."""
    found = made(tmp_path, GIVEN, ("synthesize", "check"), effort=1)
    assert found.check is not None
    assert "; at 0.9604286 s it fails (a counterexample can be replayed)." in found.summary[2]
    job, settings = Job(tmp_path / "s.yaml", tmp_path / "out"), Settings(out=tmp_path, effort=1, witness="period_max")
    again = run(job, ("replay",), settings)
    assert again.simulation is not None and again.simulation["claim"] == "period_max"
    assert 1 - 1e-9 <= again.simulation["multiplier_measured"] < 1.001
    lost = run(job, ("replay",), replace(settings, witness="nothing"))
    assert lost.status == "invalid" and "claims that have one: " in lost.messages[0].text
    assert "period_max" in lost.messages[0].text


def test_an_end_without_a_word_of_its_own_promises_none() -> None:
    (told,) = [one for one in words(make_report(check=make_check())) if "it fails" in one]
    assert told.endswith("it fails.")
