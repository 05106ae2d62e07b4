"""LPV observers with held innovation (Boukal2020)."""
