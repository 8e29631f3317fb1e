"""What a command line's numbers and paths have to be."""

from __future__ import annotations

import argparse
import math
from pathlib import Path


def check_bounds(options: argparse.Namespace, **bounds: tuple[float, float]) -> None:
    """Check options by name against their least and greatest value, both allowed; one that is None was not given.

    Raises
    ------
    ValueError
        If one lies outside or is no number; the text names it, its value and the bounds.
    """
    for name, (least, most) in bounds.items():
        value = getattr(options, name)
        if value is not None and not least <= value <= most:
            allowed = f"{least:g} or more" if math.isinf(most) else f"{least:g} to {most:g}"
            raise ValueError(f"--{name.replace('_', '-')} {value:g}: {allowed} is needed")


def named_path(text: str) -> Path:
    """Return an option's path, as argparse's ``type``; an empty text would silently be the folder that one is in.

    Raises
    ------
    argparse.ArgumentTypeError
        If it is empty, as where a script's variable is not set.
    """
    if not text:
        raise argparse.ArgumentTypeError("'' names no file or folder: is a variable not set?")
    return Path(text)
