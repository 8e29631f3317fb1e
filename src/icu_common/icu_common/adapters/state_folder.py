"""The folder in which a robot's files are kept: calibration, sign-in, audit, recordings."""

from __future__ import annotations

import os
from pathlib import Path


def default_state_folder(namespace: str = "") -> Path:
    """Return this user's folder for the robot of a ROS namespace; it need not be there yet.

    Each namespace has its own: one robot's calibration is wrong for another. ``$XDG_STATE_HOME`` counts if it is
    absolute, as freedesktop.org's base directory specification says: else each working directory would have another.
    """
    given = Path(os.environ.get("XDG_STATE_HOME", "")).expanduser()
    base = given if given.is_absolute() else Path.home() / ".local" / "state"
    return base / "icu_gantry" / namespace.strip("/")
