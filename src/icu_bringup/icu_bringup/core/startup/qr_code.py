"""The page's address as a QR code."""

from __future__ import annotations

import functools


@functools.lru_cache(maxsize=2)
def qr_modules(text: str) -> tuple[tuple[int, ...], ...]:
    """Return the modules of a text's QR code, 1 is dark, without border; empty where segno is not installed."""
    try:
        import segno  # only here: it is needed once, after the start
    except ImportError:
        return ()
    code = segno.make_qr(text, error="l", boost_error=False)
    return tuple(tuple(int(module) for module in row) for row in code.matrix)
