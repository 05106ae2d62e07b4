"""The LAPACK that Clarabel takes from SciPy, loaded without the rest of `scipy.linalg`, which takes ten times as long.

Clarabel asks for two extension modules by name and finds those that are loaded. Where they cannot be loaded by
themselves it imports all of `scipy.linalg`, as it does without this.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from pathlib import Path

_NAMES = ("scipy.linalg.cython_blas", "scipy.linalg.cython_lapack")


def load() -> None:
    """Load what is not loaded yet."""
    if "scipy.linalg" in sys.modules:
        return
    with suppress(ImportError):
        import scipy  # its folders of libraries

        for name in _NAMES:
            if name not in sys.modules:
                _load(name, Path(scipy.__file__).parent / "linalg")


def _load(name: str, folder: Path) -> None:
    spec = PathFinder.find_spec(name, [str(folder)])
    if spec is None or spec.loader is None:
        return
    module = sys.modules[name] = module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
