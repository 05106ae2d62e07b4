"""Opens the folders of tests that the benchmarks import from, and this checkout before any that is installed.

Importing it is enough; a script that is run finds it beside itself.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("simulate", "certify", "bounds", "baselines", "families/reachability")

sys.path[:0] = [str(ROOT), *(str(ROOT / "tests" / room) for room in ("", *ROOMS))]
