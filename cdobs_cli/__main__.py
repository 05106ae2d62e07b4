"""`python -m cdobs_cli` and the console script."""

from __future__ import annotations

import atexit
import gc
import os
import sys
import warnings
from contextlib import suppress

# Threads make small matrices slower; set before numpy is loaded, unless the user has decided.
for _variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
# Start fast: no search for pydantic plugins, and few collections while modules load.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
gc.set_threshold(50_000, 20, 20)
# Floats only propose; where they overflow, the proof says undecided and nobody is helped by a warning.
warnings.simplefilter("ignore", RuntimeWarning)


def main() -> None:
    """Run the command line; exits with one of the codes of `errors.ExitCode`."""
    from cdobs_cli.cli import run

    codes: list[int] = []
    atexit.register(_leave, codes)  # first of all, so that it is called last
    try:
        run()
    except SystemExit as end:
        codes += [end.code] if isinstance(end.code, int) else []
        raise


def _leave(codes: list[int]) -> None:
    """End at once: taking apart what is loaded takes longer than some commands, and the system frees it anyway."""
    if codes:
        with suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()
        os._exit(codes[0])


if __name__ == "__main__":
    main()
