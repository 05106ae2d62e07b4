"""Exact values: rationals, constants, the expression language, and matrices of them."""
