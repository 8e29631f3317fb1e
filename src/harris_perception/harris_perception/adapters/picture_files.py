"""Pictures and sequences with known homographies from files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.repeatability import Pair

SUFFIXES = {".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".bmp", ".tif", ".tiff"}


def read_gray(path: Path) -> npt.NDArray[np.uint8]:
    """Read a picture as (H, W) uint8; one of more than 8 bits is stretched to its largest value.

    Raises
    ------
    ValueError
        If the file is missing or no picture.
    """
    return _eight_bits(read_deep_gray(path))


def read_deep_gray(path: Path) -> npt.NDArray[Any]:
    """Read a picture as (H, W) uint8, or float32 from 0 to 255 if it has more than 8 bits; raises as above."""
    return _stretched(_read(path, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH))


def read_bgr(path: Path) -> npt.NDArray[np.uint8]:
    """Read a picture as (H, W, 3) uint8; stretches and raises as :func:`read_gray`."""
    picture = _eight_bits(_stretched(_read(path, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)))
    return picture if picture.ndim == 3 else np.repeat(picture[:, :, None], 3, axis=2)


def _stretched(picture: npt.NDArray[Any]) -> npt.NDArray[Any]:
    if picture.dtype == np.uint8:
        return picture
    values = picture.astype(np.float32)
    known = np.isfinite(values)
    values -= values.min(initial=0.0, where=known)  # what is negative is above the lowest, not black
    top = float(values.max(initial=0.0, where=known))
    return values * np.float32(255.0 / top if top > 0.0 else 0.0)


def _eight_bits(picture: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    if picture.dtype == np.uint8:
        return picture
    return np.asarray(np.rint(np.nan_to_num(picture, posinf=255.0)), np.uint8)


def _read(path: Path, how: int) -> npt.NDArray[Any]:
    if not path.exists():
        raise ValueError(f"{path} does not exist")
    picture = cv2.imread(str(path), how) if path.is_file() else None
    if picture is None:
        raise ValueError(f"{path} is no picture that can be read")
    return np.asarray(picture)


def sequences(folder: Path) -> Iterator[tuple[str, list[Path], list[npt.NDArray[np.float64]]]]:
    """Yield name, pictures 1 to n and homographies 1 to 2..n of each sequence below a folder (img1..6, H1to2p).

    Raises
    ------
    ValueError
        If of a picture and its homography one is missing, or a homography is none.
    """
    for first in sorted(p for p in folder.rglob("img1.*") if p.suffix.lower() in SUFFIXES):
        known = {int(p.name[4:-1]) for p in first.parent.glob("H1to*p") if p.name[4:-1].isdecimal()}
        pictures = {
            int(p.stem[3:]): p
            for p in sorted(first.parent.glob("img*.*"))
            if p.suffix.lower() in SUFFIXES and p.stem[3:].isdecimal()
        }
        if not known:
            continue
        for number in sorted(known ^ (set(pictures) - {1})):
            missing = f"H1to{number}p" if number in pictures else f"img{number}.*"
            raise ValueError(f"{first.parent / missing} is missing")
        numbers = sorted(known)
        homographies = [_homography(first.with_name(f"H1to{number}p")) for number in numbers]
        yield first.resolve().parent.name, [first, *(pictures[n] for n in numbers)], homographies


def _homography(path: Path) -> npt.NDArray[np.float64]:
    try:
        values = np.array(path.read_text().split(), np.float64)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    if values.shape != (9,) or not np.isfinite(values).all() or np.linalg.matrix_rank(values.reshape(3, 3)) < 3:
        raise ValueError(f"{path} is no homography: 3 x 3 finite numbers are needed, and an inverse")
    return values.reshape(3, 3)


def pairs_of_sequence(name: str, pictures: list[Path], homographies: list[npt.NDArray[np.float64]]) -> Iterator[Pair]:
    """Yield the pairs 1-2 to 1-n; what changed is the sequence's name, the amount is the picture's number."""
    first = read_gray(pictures[0])
    for path, homography in zip(pictures[1:], homographies):
        yield Pair(name, float(path.stem[3:]), first, read_gray(path), homography)
