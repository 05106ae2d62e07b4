"""The registry of families: an import and one line each. Nothing else lists them.

The spec makes the discriminated union of these classes, told apart by their `family` key.
"""

from __future__ import annotations

from cdobs_cli.families.base import Family
from cdobs_cli.families.interval import Interval
from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.families.updated_sampling import UpdatedSampling

FAMILIES: dict[str, type[Family]] = {
    "reachability": Reachability,
    "lpv_zoh": LpvZeroOrderHold,
    "interval": Interval,
    "updated_sampling": UpdatedSampling,
}

__all__ = ["FAMILIES", "Family"]
