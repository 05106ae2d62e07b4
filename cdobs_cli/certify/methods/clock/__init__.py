"""The clock-dependent certificate: a quadratic function whose matrix depends on the time since the last sample."""
