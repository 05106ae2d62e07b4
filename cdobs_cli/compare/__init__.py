"""Comparisons: the families that take a plant, gains that are given, and baselines, side by side."""
