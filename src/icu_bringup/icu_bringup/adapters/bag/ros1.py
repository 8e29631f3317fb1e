"""Recognise the bags of ROS 1, and name the program that converts them."""

from __future__ import annotations

import shlex
from pathlib import Path

_MAGIC = b"#ROSBAG V"


def is_ros1(path: Path) -> bool:
    """Return whether a file is a bag of ROS 1, whatever its name.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(len(_MAGIC)) == _MAGIC


def conversion_advice(path: Path) -> str:
    """Return an error text with the command that converts a bag of ROS 1."""
    target = path.with_name(f"{path.stem}_ros2")
    command = f"rosbags-convert --src {shlex.quote(str(path))} --dst {shlex.quote(str(target))}"
    return f"{path} is a ROS 1 bag; convert it with: {command} --dst-storage mcap --dst-typestore ros2_jazzy"
