"""cdobs: observers for continuous-time plants measured at discrete instants, designed and proved."""

__version__ = "0.2.0"
