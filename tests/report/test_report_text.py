"""report.md and the terminal summary, against stored text."""

from pathlib import Path

from conftest import make_check, make_design, make_report

from cdobs_cli.design import Design
from cdobs_cli.report.model import Report
from cdobs_cli.report.text import summary_lines

GOLDEN = Path(__file__).parent / "golden"


def test_markdown(files: dict[str, bytes]) -> None:
    assert files["report.md"].decode() == (GOLDEN / "report.md").read_text(encoding="utf-8")


def test_summary(report: Report) -> None:
    assert "\n".join(summary_lines(report)) + "\n" == (GOLDEN / "summary.txt").read_text(encoding="utf-8")


def test_summary_without_a_design() -> None:
    law = make_design().sampling
    none = Design("copying", "none", law, {}, reason="the pair (A, C) is not detectable")
    report = make_report(design=none)
    lines = summary_lines(report)
    assert lines[0] == "reachability_pendulum: no design found"
    assert "  the pair (A, C) is not detectable" in lines
    assert report.charts == ()


def test_conditions_name_domain_and_constant_period() -> None:
    first, second = make_report(check=make_check()).conditions
    assert "-3.2 ≤ theta ≤ 3.2" in first and "not decided" in first
    assert "not implied" in second
