"""The numbers of the Dormand-Prince method of order 8(5,3), which simulations and exported observers step with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

# What each of these is stands in the file.
TABLEAU: dict[str, Any] = json.loads(Path(__file__).with_name("dop853.json").read_text(encoding="utf-8"))
STAGES = 12
