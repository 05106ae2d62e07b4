"""Sweeps: a grid over fields of a spec, one table, figures; what stands is not done again."""
