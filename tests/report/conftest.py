"""The sample report, and its files."""

from __future__ import annotations

import pytest
from report_pendulum import make_check, make_report, make_run

from cdobs_cli.report.model import Report


@pytest.fixture(scope="session")
def report() -> Report:
    return make_report(check=make_check(), run=make_run())


@pytest.fixture(scope="session")
def files(report: Report) -> dict[str, bytes]:
    from cdobs_cli.report.drawings import Drawings
    from cdobs_cli.report.files import render

    return render(report, Drawings(lambda _: None))
