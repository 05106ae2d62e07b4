"""Why a run ends before its horizon, but for what the watch looks at."""

from __future__ import annotations

from enum import IntEnum


class Ending(IntEnum):
    """The numbers are those of engine.c; WATCH + k is reason k of the watch."""

    HORIZON = 0
    NO_STEP = 1
    STEPS = 2
    SAMPLES = 3
    CROWDED = 4
    UNREADY = 5
    START = 6
    WATCH = 7


GROWN = "the states grow without bound in finite time"
# That of STEPS says how fast the flow is.
SENTENCES = {
    Ending.NO_STEP: "the equations are undefined or singular beyond this point",
    Ending.SAMPLES: "more than {max_samples} measurements before the horizon",
    Ending.CROWDED: "sampling instants accumulate: they come faster than time can be resolved",
    Ending.UNREADY: "the trigger is not below 0 just after a sample, so that no next sample is defined",
    Ending.START: "the observer's start is undefined",
}
