"""The one place that asks for numba, so that its absence and an unwritable cache are told plainly.

numba keeps machine code beside the source file, or in the user's cache directory where the source tree is read-only
(``NUMBA_CACHE_DIR`` overrides both). Where neither can be written the functions are compiled anew in each process.
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

# Contraction to fused multiply-add and nothing else: NaN pixels must stay NaN, and sums of integers exact.
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
    """Compile a function that compiled ones call; one copy, which keeps compiling short.

    Where it is changed in a file of its own, ``scripts/setup.sh`` must follow: the cache looks at the callers' files.
    """
    result: F = numba.njit(nogil=True, fastmath=_FASTMATH, error_model="numpy")(function)
    return result


def inlined(function: F) -> F:
    """Compile a function that becomes part of the compiled ones which call it, once for each call.

    For loops over rows: one that stays a call does not know that its rows do not overlap, and is not vectorised.
    """
    result: F = numba.njit(nogil=True, fastmath=_FASTMATH, error_model="numpy", inline="always")(function)
    return result
