"""The command line as a user runs it: what tests of it share."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parent.parent
Cdobs = Callable[..., "subprocess.CompletedProcess[str]"]
