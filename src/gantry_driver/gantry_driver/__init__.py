"""GRBL serial driver, gantry controller and mock serial port for an XY stage with a stylus.

:class:`GrblClient` homes a board on a serial port and runs G-code on it. It needs no ROS.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gantry_driver.adapters.grbl_client import GrblClient, GrblError

__all__ = ["GrblClient", "GrblError"]


def __getattr__(name: str) -> Any:
    """Import the client at its first use: the nodes and the simulated board start without it."""
    if name in __all__:
        return getattr(import_module("gantry_driver.adapters.grbl_client"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
