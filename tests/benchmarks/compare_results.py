"""Two results folders side by side: verdicts, bounds and witnesses of every spec, `before` against `after`.

    python tests/benchmarks/compare_results.py BEFORE AFTER

Prints one line for each difference, and a table; exits 1 where a verdict differs or a bound is worse.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

SLACK = 1e-9  # relative: digits beyond a search's own tolerance say nothing


def read(folder: Path) -> dict[str, Any]:
    return {
        str(path.parent.relative_to(folder)): json.loads(path.read_text(encoding="utf-8"))
        for path in sorted(folder.rglob("check.json"))
    }


def ends(bound: dict[str, Any]) -> tuple[float | None, float | None]:
    proved, refuted = bound["proved"], bound["refuted"]
    return (None if proved is None else float(proved), None if refuted is None else float(refuted))


def change(before: float | None, after: float | None, sign: float) -> float:
    """How much better, relative; infinite where a value appears (or, negative, where it goes)."""
    if before == after:
        return 0.0
    if before is None or after is None:
        return float("inf") if before is None else float("-inf")
    return sign * (after - before) / max(abs(before), 1e-300)


def differences(before: dict[str, Any], after: dict[str, Any]) -> list[tuple[str, str, float]]:
    """(what, text, how much better) of one spec."""
    rows = []
    if before["verdict"] != after["verdict"]:
        rows.append(("verdict", f"{before['verdict']} -> {after['verdict']}", float("-inf")))
    kinds = [
        next((c["witness"] and c["witness"]["kind"] for c in one["claims"] if c["id"] == "convergence"), None)
        for one in (before, after)
    ]
    if kinds[0] != kinds[1]:
        rows.append(("witness", f"{kinds[0]} -> {kinds[1]}", 0.0 if kinds[1] else float("-inf")))
    for name in sorted(before["bounds"].keys() | after["bounds"].keys()):
        nothing = {"proved": None, "refuted": None, "better": "more"}
        one, other = before["bounds"].get(name, nothing), after["bounds"].get(name, nothing)
        sign = 1.0 if (one if name in before["bounds"] else other)["better"] == "more" else -1.0
        for which, a, b, way in zip(("proved", "refuted"), ends(one), ends(other), (sign, -sign), strict=True):
            better = change(a, b, way)
            if abs(better) > SLACK:
                rows.append((f"{name}.{which}", f"{a} -> {b}", better))
    return rows


def main() -> int:
    before, after = (read(Path(folder)) for folder in sys.argv[1:3])
    worse = 0
    for spec in sorted(before.keys() | after.keys()):
        if spec not in before or spec not in after:
            print(f"{spec}: only {'before' if spec in before else 'after'}")
            worse += spec not in after
            continue
        for what, text, better in differences(before[spec], after[spec]):
            mark = "worse" if better < 0 else "better" if better > 0 else "other"
            worse += better < -5e-4
            print(
                f"{mark:6} {spec:45} {what:40} {text}"
                + (f" ({better:+.2e})" if abs(better) not in (0.0, float("inf")) else "")
            )
    print(f"{len(before)} specs before, {len(after)} after; {worse} worse by more than 0.05 %")
    return 1 if worse else 0


if __name__ == "__main__":
    sys.exit(main())
