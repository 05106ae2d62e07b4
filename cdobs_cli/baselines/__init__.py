"""Observers to compare with: a constant gain at a constant period, and the continuous-discrete Kalman filter."""
