"""Pictures and sequences with known homographies from files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.repeatability import Pair

SUFFIXES = {".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".bmp", ".tif", ".tiff"}


def read_gray(path: Path) -> npt.NDArray[np.uint8]:
    """Read a picture as (H, W) uint8.

    Raises
    ------
    ValueError
        If the file is missing or no picture.
    """
    return _read(path, cv2.IMREAD_GRAYSCALE)


def read_bgr(path: Path) -> npt.NDArray[np.uint8]:
    """Read a picture as (H, W, 3) uint8; raises as :func:`read_gray`."""
    return _read(path, cv2.IMREAD_COLOR)


def _read(path: Path, how: int) -> npt.NDArray[np.uint8]:
    picture = cv2.imread(str(path), how) if path.is_file() else None
    if picture is None:
        raise ValueError(f"{path} is no picture that can be read")
    return np.asarray(picture, np.uint8)


def sequences(folder: Path) -> Iterator[tuple[str, list[Path], list[npt.NDArray[np.float64]]]]:
    """Yield name, pictures 1 to n and homographies 1 to 2..n of each sequence below a folder (img1..6, H1to2p)."""
    for first in sorted(folder.rglob("img1.*")):
        if first.suffix.lower() not in SUFFIXES:
            continue
        pictures, homographies = [first], []
        for number in range(2, 100):
            following, truth = first.with_name(f"img{number}{first.suffix}"), first.with_name(f"H1to{number}p")
            if not (following.is_file() and truth.is_file()):
                break
            pictures.append(following)
            homographies.append(np.loadtxt(truth).reshape(3, 3))
        if homographies:
            yield first.parent.name, pictures, homographies


def pairs_of_sequence(name: str, pictures: list[Path], homographies: list[npt.NDArray[np.float64]]) -> Iterator[Pair]:
    """Yield the pairs 1-2 to 1-n; what changed is the sequence's name, the amount is the picture's number."""
    first = read_gray(pictures[0])
    for number, (path, homography) in enumerate(zip(pictures[1:], homographies), start=2):
        yield Pair(name, float(number), first, read_gray(path), homography)
