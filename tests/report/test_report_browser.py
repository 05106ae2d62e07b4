"""The index page in a real browser, where one is installed: it sorts, and says nothing on the console."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from cdobs_cli.certificate import Bound
from cdobs_cli.report.index import IndexEntry, index_page
from cdobs_cli.report.style import source_hash

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
QUIET = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--enable-logging=stderr",
)  # fmt: skip


def dump(page: bytes, folder: Path, script: str) -> tuple[list[str], str]:
    """The names of the rows after a script has run, and what the browser's console said."""
    path = folder / "index.html"
    page = page.replace(b"script-src ", f"script-src {source_hash(script)} ".encode())
    path.write_bytes(page.replace(b"</body>", f"<script>{script}</script></body>".encode()))
    command = [str(BROWSER), *QUIET, f"--user-data-dir={folder / 'profile'}", "--dump-dom", path.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    rows = re.findall(r'<tr><td data-key="([^"]*)"', done.stdout)
    return rows, "\n".join(line for line in done.stderr.splitlines() if "CONSOLE" in line)


@pytest.mark.skipif(BROWSER is None, reason="no browser is installed")
@pytest.mark.parametrize(
    ("column", "clicks", "order"),
    [
        ("spec", 1, ["a", "b", "c"]),
        ("spec", 2, ["c", "b", "a"]),
        ("bracket", 1, ["b", "a", "c"]),
        ("verdict", 1, ["c", "b", "a"]),
    ],
)
def test_sorting(column: str, clicks: int, order: list[str], tmp_path: Path) -> None:
    page = index_page(
        [
            IndexEntry("b", "B", "refuted", bound_name="period_max", bound=Bound("0.9", "1.2")),
            IndexEntry("a", "A", "proved", bound_name="period_max", bound=Bound("10.5", None)),
            IndexEntry("c", "C", "failed", message="it fell over"),
        ]
    )
    click = f"document.querySelectorAll('th button').forEach(b => {{ if (b.textContent === '{column}') b.click(); }});"
    rows, console = dump(page, tmp_path, click * clicks)
    assert rows == order
    assert console == ""
