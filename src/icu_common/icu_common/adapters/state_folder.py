"""Folder of a robot's files: calibration, sign-in, audit, recordings."""

from __future__ import annotations

import os
from pathlib import Path


def default_state_folder(namespace: str = "") -> Path:
    """Return this user's folder for the robot of a ROS namespace; it may not exist yet.

    Each namespace has its own folder: one robot's calibration is wrong for another. A relative ``$XDG_STATE_HOME`` is
    ignored, as freedesktop.org's base directory specification requires: the folder would depend on the working
    directory.
    """
    given = Path(os.environ.get("XDG_STATE_HOME", "")).expanduser()
    base = given if given.is_absolute() else Path.home() / ".local" / "state"
    return base / "icu_gantry" / namespace.strip("/")
