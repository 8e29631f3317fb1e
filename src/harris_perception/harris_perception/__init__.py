"""Harris corners, stereo matching, hand-eye calibration and panel recognition.

:func:`detect_corners` and :func:`detect_edges` work on numpy arrays and need no ROS.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from harris_perception.core.edges.detect import detect_corners, detect_edges

__all__ = ["detect_corners", "detect_edges"]


def __getattr__(name: str) -> Any:
    """Import the detector at its first use: most programs of this package start without it."""
    if name in __all__:
        return getattr(import_module("harris_perception.core.edges.detect"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
