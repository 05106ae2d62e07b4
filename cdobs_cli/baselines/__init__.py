"""Observers to compare with: a constant gain, the continuous-discrete Kalman filter, an output predictor."""
