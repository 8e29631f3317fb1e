"""Checks of numbers and paths on a command line."""

from __future__ import annotations

import argparse
import math
from pathlib import Path


def check_bounds(options: argparse.Namespace, **bounds: tuple[float, float]) -> None:
    """Check options by name against their minimum and maximum, both allowed; None means not given.

    Raises
    ------
    ValueError
        If an option is out of bounds or not a number; the text has its name, its value and the bounds.
    """
    for name, (least, most) in bounds.items():
        value = getattr(options, name)
        if value is not None and not least <= value <= most:
            allowed = f"{least:g} or more" if math.isinf(most) else f"{least:g} to {most:g}"
            raise ValueError(f"--{name.replace('_', '-')} {value:g}; expected {allowed}")


def named_path(text: str) -> Path:
    """Return an option's path, as argparse's ``type``; an empty text would silently be the working directory.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is empty, for example because a variable of a script is not set.
    """
    if not text:
        raise argparse.ArgumentTypeError("'' names no file or folder: is a variable not set?")
    return Path(text)
