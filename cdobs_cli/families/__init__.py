"""The registry of families: one name in the union for each. Nothing else lists them."""

from __future__ import annotations
