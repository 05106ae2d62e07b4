"""Sensors that send on change: practical stability, and how large the error stays."""
