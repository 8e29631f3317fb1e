"""Rectified pairs with known disparity from folders, in the forms in which such images are distributed."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.adapters.picture_files import SUFFIXES, decoded, read_gray
from harris_perception.core.evaluation.stereo_evaluation import StereoScene

FORMS = (("L", "R", "GT"), ("_left", "_right", "_disp"), ("im0", "im1", "disp0"), ("view1", "view5", "disp1"))
"""Name endings, without suffix, of the left image, the right image and the left image's disparity."""
_TRUTH_SUFFIXES = (".npz", ".npy", ".pfm", ".png")


def scenes(folder: Path, truth_scale: float = 1.0, scale: float = 1.0) -> Iterator[StereoScene]:
    """Yield the pairs in a folder and below it.

    Parameters
    ----------
    folder
        Contains, at any depth, a left and a right image and the left one's disparity in px: grey values (0 = unknown),
        or npz, npy, pfm with floats (not finite = unknown).
    truth_scale
        Pixels of disparity per unit in the file.
    scale
        Factor by which images and disparities are reduced; at most 1.

    Raises
    ------
    ValueError
        If there are no pairs, a file cannot be read, or its size differs from that of the other two.
    """
    if not 0.05 <= scale <= 1.0:
        raise ValueError(f"scale {scale:g}: from 0.05 to 1 is possible")
    if not 0.0 < truth_scale < math.inf:
        raise ValueError(f"truth scale {truth_scale:g}; expected more than 0, and finite")
    found: list[tuple[str, Path, Path, Path]] = []
    for left in sorted(p for p in folder.rglob("*") if p.suffix.lower() in SUFFIXES):
        for first, second, known in FORMS:
            if not left.stem.endswith(first):
                continue
            stem = left.stem.removesuffix(first)
            right = next((p for s in SUFFIXES if (p := left.with_name(stem + second + s)).is_file()), None)
            truth = next((p for s in _TRUTH_SUFFIXES if (p := left.with_name(stem + known + s)).is_file()), None)
            if right is not None and truth is not None:
                found.append((stem, left, right, truth))
    if not found:
        forms = "; ".join(f"*{a}, *{b}, *{c}" for a, b, c in FORMS)
        raise ValueError(f"{folder} has no pair with known disparity: {forms}")
    folders = Counter(left.resolve().parent.name for _, left, _, _ in found)
    for stem, left, right, truth in found:
        name = left.resolve().parent.name
        if folders[name] > 1:  # results are stored by name: several pairs may be in one folder, or folders share a name
            name = "_".join(part for part in (*left.relative_to(folder).parent.parts, stem.rstrip("_")) if part)
        yield _scene(name, left, right, truth, truth_scale, scale)


def _scene(name: str, left: Path, right: Path, truth: Path, truth_scale: float, scale: float) -> StereoScene:
    pictures = [read_gray(path) for path in (left, right)]
    disparity = _disparity(truth) * np.float32(truth_scale)
    whole = StereoScene(name=name, left=pictures[0], right=pictures[1], truth=disparity)  # also checked when reduced
    if scale == 1.0:
        return whole
    height, width = disparity.shape
    size = round(width * scale), round(height * scale)
    pictures = [np.asarray(cv2.resize(p, size, interpolation=cv2.INTER_AREA), np.uint8) for p in pictures]
    disparity = np.asarray(cv2.resize(disparity, size, interpolation=cv2.INTER_NEAREST), np.float32)
    return StereoScene(name=name, left=pictures[0], right=pictures[1], truth=disparity * np.float32(size[0] / width))


def _disparity(path: Path) -> npt.NDArray[np.float32]:
    """Return (H, W) float32, NaN where unknown."""
    values: Any
    try:
        if path.suffix == ".npz":
            with np.load(path) as file:
                values = file[file.files[0]]
        elif path.suffix == ".pfm":
            values = _pfm(path.read_bytes())
        elif path.suffix == ".npy":
            values = np.load(path)
        else:
            values = decoded(path, cv2.IMREAD_UNCHANGED)
    except (OSError, ValueError, IndexError, EOFError, BadZipFile) as error:
        raise ValueError(f"{path} is no disparity that can be read: {error}") from error
    if values is None or values.ndim != 2:
        raise ValueError(f"{path} is no disparity picture of one channel")
    disparity = values.astype(np.float32)
    return np.where(np.isfinite(disparity) & (disparity > 0), disparity, np.float32(np.nan))


def _pfm(content: bytes) -> npt.NDArray[np.float32]:
    """Return (H, W) float32 of a portable float map, which starts with the lowest row.

    The sign of the scale gives the byte order; its size has no meaning (vision.middlebury.edu/stereo/submit3,
    upload-format.html). OpenCV divides by it, which makes Middlebury's own disparities 255 times too large.
    """
    head = re.match(rb"Pf\s+(\d+)\s+(\d+)\s+(\S+)\s", content)
    if head is None:
        raise ValueError("no portable float map of one channel")
    width, height, scale = int(head[1]), int(head[2]), float(head[3])
    values = np.frombuffer(content, "<f4" if scale < 0 else ">f4", width * height, head.end())
    return values.reshape(height, width)[::-1].astype(np.float32)
