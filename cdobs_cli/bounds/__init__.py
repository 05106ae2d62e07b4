"""How large is an expression over a region: the nonlinearity put to the proof. Knows nothing of error systems."""
