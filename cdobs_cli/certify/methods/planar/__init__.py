"""Planar error systems whose jump clears the measured error: the exact bound of the period, for one gain and for
all."""
