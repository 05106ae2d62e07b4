"""`make pages`: every kind of page as pictures, wide and narrow, light and dark, and in print; with html-validate and
axe where node is installed.

Pictures are for people to look at; what the two checkers find makes it fail.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
from html import unescape
from pathlib import Path

HERE = Path(__file__).parent
SPECS = HERE.parents[1] / "specs"
OUT = Path("build") / "pages"
# A proof, one with noise and units, several sensors, chosen instants, intervals, a refutation with its counterexample.
KINDS = (
    "reachability_pendulum", "plant_motor", "plant_vehicle_sensors", "updated_sampling_unstable", "interval_pendulum",
    "lpv_zoh_bioreactor_slopes_refuted",
)  # fmt: skip
WIDTHS = (1280, 390)
LOOKS = {"light": "1", "dark": "0"}
CHECKERS = ("html-validate@11", "axe-core@4")
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
QUIET = ("--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--disable-background-networking")
# Chromium's narrowest window is wider than a phone: a frame of its own is as narrow as is asked.
FRAME = '<body style="margin:0"><iframe src="{page}" style="border:0;width:{width}px;height:{height}px"></iframe>'
_AXE = """<script>{code}</script><script>axe.run({{iframes: false}}).then(found => {{
  const told = found.violations.map(one => [one.id, one.help, one.nodes.slice(0, 3).map(node => node.html)]);
  document.body.innerHTML = '<pre id="found"></pre>';
  document.getElementById('found').textContent = JSON.stringify(told);
}});</script></body>"""


def main() -> int:
    """The number of findings, as an exit code of 0 or 1."""
    made = pages()
    browser = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if browser is None:
        print("No chromium is installed: no pictures were taken, and axe was not run.")
    else:
        for name, page in made.items():
            pictures(browser, name, page)
        print(f"Pictures of {len(made)} pages are in {OUT / 'pictures'}.")
    findings = checked(browser, made)
    print("\n".join(findings))
    return min(len(findings), 1)


def pages() -> dict[str, Path]:
    """The index and each report, by name."""
    specs = OUT / "specs"
    shutil.rmtree(specs, ignore_errors=True)
    specs.mkdir(parents=True)
    for path in (*(SPECS / f"{name}.yaml" for name in KINDS), HERE / "unseen_angle.yaml"):
        shutil.copy(path, specs)
    results = OUT / "results"
    for page in results.glob("*/report.html"):  # of another version of the pages, perhaps
        page.unlink()
    subprocess.run(
        [sys.executable, "-m", "cdobs_cli", "run", str(specs), "--out", str(results)], check=False, capture_output=True
    )
    made = {"index": results / "index.html"}
    return made | {path.stem: results / path.stem / "report.html" for path in sorted(specs.iterdir())}


def pictures(browser: str, name: str, page: Path) -> None:
    """One for each width and look, and the page as it is printed."""
    folder = (OUT / "pictures").resolve()
    folder.mkdir(parents=True, exist_ok=True)
    framed = page.with_name("framed.html")
    for width in WIDTHS:
        height = _height(browser, page, width)
        framed.write_text(FRAME.format(page=page.name, width=width, height=height), encoding="utf-8")
        for look, scheme in LOOKS.items():
            shown = f"--screenshot={folder / f'{name}-{width}-{look}.png'}"
            _run(browser, framed, f"--blink-settings=preferredColorScheme={scheme}",
                 f"--window-size={max(width, 500)},{height}", shown)  # fmt: skip
    framed.unlink()
    _run(browser, page, "--no-pdf-header-footer", f"--print-to-pdf={folder / f'{name}.pdf'}")


def _height(browser: str, page: Path, width: int) -> int:
    """Of the page at a width; it is no wider than that."""
    script = (
        "<script>addEventListener('load', () => {"
        "document.title = `${document.documentElement.scrollWidth} ${document.documentElement.scrollHeight}`})</script>"
    )
    probe, framed = page.with_name("probe.html"), page.with_name("framed.html")
    probe.write_text(_open(page).replace("</body>", f"{script}</body>"), encoding="utf-8")
    ask = "<script>addEventListener('load', () => setTimeout(() => document.body.append(frames[0].document.title)))"
    frame = FRAME.format(page=probe.name, width=width, height=800)
    framed.write_text(f"{frame}{ask}</script>", encoding="utf-8")
    dumped = _run(browser, framed, "--allow-file-access-from-files", "--virtual-time-budget=3000", "--dump-dom")
    probe.unlink()
    seen, height = map(int, re.findall(r"(\d+) (\d+)</body>", dumped)[0])
    if seen > width:
        print(f"{page}: at {width} pixels it is {seen} wide")
    return height


def checked(browser: str | None, made: dict[str, Path]) -> list[str]:
    """What html-validate and axe find; a sentence and nothing where node is missing."""
    npm, node = shutil.which("npm"), shutil.which("node")
    if npm is None or node is None:
        print("No node is installed: html-validate and axe were not run.")
        return []
    modules = OUT / "node"
    modules.mkdir(parents=True, exist_ok=True)
    shutil.copy(HERE / "validate.mjs", modules)
    subprocess.run(
        [npm, "install", "--no-audit", "--no-fund", "--silent", "--prefix", str(modules), *CHECKERS], check=True
    )
    paths = [str(page) for page in made.values()]
    said = subprocess.run([node, str(modules / "validate.mjs"), *paths], check=True, capture_output=True, text=True)
    findings = said.stdout.splitlines()
    if browser is not None:
        axe = (modules / "node_modules" / "axe-core" / "axe.min.js").read_text(encoding="utf-8")
        findings += [one for page in made.values() for look in LOOKS for one in _axe(browser, page, look, axe)]
    return findings


def _axe(browser: str, page: Path, look: str, code: str) -> list[str]:
    probe = page.with_name("probe.html")
    probe.write_text(_open(page).replace("</body>", _AXE.format(code=code)), encoding="utf-8")
    scheme = f"--blink-settings=preferredColorScheme={LOOKS[look]}"
    dumped = _run(browser, probe, scheme, "--virtual-time-budget=60000", "--dump-dom")
    probe.unlink()
    found = re.search(r'<pre id="found">(.*?)</pre>', dumped, re.DOTALL)
    if found is None:
        return [f"{page}: axe gave no answer"]
    return [f"{page} ({look}): {rule}: {text}: {nodes}" for rule, text, nodes in json.loads(unescape(found[1]))]


def _open(page: Path) -> str:
    """The page without the policy that keeps foreign scripts out."""
    return re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page.read_text(encoding="utf-8"))


def _run(browser: str, page: Path, *options: str) -> str:
    with tempfile.TemporaryDirectory() as profile:
        command = [browser, *QUIET, f"--user-data-dir={profile}", *options, page.resolve().as_uri()]
        return subprocess.run(command, check=True, capture_output=True, text=True, timeout=120).stdout


if __name__ == "__main__":
    sys.exit(main())
