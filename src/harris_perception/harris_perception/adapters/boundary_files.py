"""Images with boundaries drawn by people, in the form of BSDS500, from files."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from harris_perception.adapters.picture_files import SUFFIXES, read_bgr


def drawn_pictures(folder: Path) -> list[tuple[Path, Path]]:
    """Return images and their .mat files below a folder, by name.

    The image is next to <name>.mat, or in ``images`` if the .mat file is in ``groundTruth``.

    Raises
    ------
    ValueError
        If an image is missing.
    """
    found = []
    for path in sorted(folder.rglob("*.mat"), key=lambda p: (p.name, p)):
        picture = next(_candidates(path), None)
        if picture is None:
            raise ValueError(f"{path} has no picture {path.stem}.* beside it, or in images instead of groundTruth")
        found.append((picture, path))
    return found


def _candidates(path: Path) -> Iterator[Path]:
    parts = path.parent.absolute().parts
    others = [Path(*parts[:i], "images", *parts[i + 1 :]) for i, part in enumerate(parts) if part == "groundTruth"]
    for folder in (path.parent, *others):
        # Whole names are compared: a name may contain dots and the characters of a glob pattern.
        yield from (p for p in sorted(folder.glob("*")) if p.stem == path.stem and p.suffix.lower() in SUFFIXES)


def read_drawn(picture: Path, path: Path) -> tuple[npt.NDArray[np.uint8], list[npt.NDArray[np.bool_]]]:
    """Read an image (H, W, 3) uint8, BGR, and the boundaries that each person drew in it, (H, W) each.

    Raises
    ------
    ValueError
        If a file cannot be read, has another form or size, or scipy is missing.
    """
    try:
        from scipy.io import loadmat
    except ImportError as error:
        raise ValueError(f"{path}: drawn boundaries need scipy ({sys.executable} -m pip install scipy)") from error
    bgr = read_bgr(picture)
    try:
        persons = loadmat(str(path))["groundTruth"].ravel()
        drawings = [np.ascontiguousarray(person["Boundaries"][0, 0] != 0) for person in persons]
    except Exception as error:  # scipy may raise anything for a file of another kind
        raise ValueError(f"{path} cannot be read as groundTruth with Boundaries of each person: {error}") from error
    if not drawings:
        raise ValueError(f"{path} holds the drawings of 0 persons; expected at least 1")
    for drawn in drawings:
        if drawn.shape != bgr.shape[:2]:
            raise ValueError(f"{path} has a drawing of {drawn.shape} px, {picture.name} has {bgr.shape[:2]}")
    return bgr, drawings
