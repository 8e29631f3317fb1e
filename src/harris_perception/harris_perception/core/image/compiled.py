"""The only import of numba, so that a missing numba and an unwritable cache are reported clearly.

numba caches machine code next to the source file, or in the user's cache directory if the source tree is read-only
(``NUMBA_CACHE_DIR`` overrides both). If neither is writable, functions are compiled again in each process.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, TypeVar

try:
    import numba
    from numba import types as types
    from numba.core import cgutils as cgutils
    from numba.core.errors import TypingError as TypingError
    from numba.extending import intrinsic as intrinsic
except ImportError as error:
    raise ImportError(
        "harris_perception needs numba: install python3-numba (rosdep key) or 'pip install numba'"
    ) from error

F = TypeVar("F", bound=Callable[..., Any])

# Allow only contraction to fused multiply-add: NaN pixels must stay NaN, and sums of integers exact.
_FASTMATH = {"contract", "nsz"}


def compiled(function: F) -> F:
    """Compile a function of numpy arrays to machine code without the interpreter's lock, cached on disk if possible."""
    options: dict[str, Any] = {"nogil": True, "fastmath": _FASTMATH, "error_model": "numpy"}
    try:
        result: F = numba.njit(cache=True, **options)(function)
    except RuntimeError as error:  # "no locator available": no directory for the cache
        warnings.warn(f"{function.__name__} is compiled in every process: {error}", RuntimeWarning, stacklevel=2)
        result = numba.njit(**options)(function)
    return result


def called(function: F) -> F:
    """Compile a function called by compiled ones; there is one copy of it, which keeps compiling short.

    After changing such a function in a file of its own, ``scripts/setup.sh`` must be run: the cache checks only the
    callers' files.
    """
    result: F = numba.njit(nogil=True, fastmath=_FASTMATH, error_model="numpy")(function)
    return result


def inlined(function: F) -> F:
    """Compile a function that is inlined into the compiled functions that call it, once per call.

    For loops over rows: a function that is called cannot know that its rows do not overlap, and is not vectorised.
    """
    result: F = numba.njit(nogil=True, fastmath=_FASTMATH, error_model="numpy", inline="always")(function)
    return result
