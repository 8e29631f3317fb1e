"""Images and image sequences with known homographies from files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.evaluation.repeatability import HomographyPair

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".pgm", ".tif", ".tiff", ".webp")
"""Suffixes, in lower case, of the files in a folder that are read as images."""


def read_gray(path: Path) -> npt.NDArray[np.uint8]:
    """Read an image as (H, W) uint8; an image with more than 8 bits is scaled to its largest value.

    Raises
    ------
    ValueError
        If the file is missing, is no image, or has more pixels than OpenCV reads.
    """
    return _eight_bits(read_deep_gray(path))


def read_sensor_gray(path: Path) -> npt.NDArray[np.uint8]:
    """Read an image in the sensor's orientation, ignoring EXIF; otherwise like :func:`read_gray`.

    A lens's centre and distortion are fixed to the sensor.
    """
    how = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    return _eight_bits(_stretched(_read(path, how)))


def read_deep_gray(path: Path) -> npt.NDArray[Any]:
    """Read an image as (H, W) uint8, or as float32 from 0 to 255 if it has more than 8 bits.

    Raises like :func:`read_gray`. A colour image is scaled like :func:`read_bgr` does, so that the strengths of both
    have the same unit.
    """
    gray = _read(path, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    if gray.dtype == np.uint8:
        return gray
    deep = _stretched(_read(path, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH))
    return deep if deep.ndim == 2 else cv2.cvtColor(deep, cv2.COLOR_BGR2GRAY)


def read_bgr(path: Path) -> npt.NDArray[np.uint8]:
    """Read an image as (H, W, 3) uint8; scales and raises like :func:`read_gray`."""
    picture = _eight_bits(_stretched(_read(path, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH)))
    return picture if picture.ndim == 3 else np.repeat(picture[:, :, None], 3, axis=2)


def _stretched(picture: npt.NDArray[Any]) -> npt.NDArray[Any]:
    if picture.dtype == np.uint8:
        return picture
    values = picture.astype(np.float32)
    known = np.isfinite(values)
    values -= values.min(initial=0.0, where=known)  # negative values are relative to the lowest value, not black
    top = float(values.max(initial=0.0, where=known))
    return values * np.float32(255.0 / top if top > 0.0 else 0.0)


def _eight_bits(picture: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    if picture.dtype == np.uint8:
        return picture
    return np.asarray(np.rint(np.nan_to_num(picture, posinf=255.0)), np.uint8)


def _read(path: Path, how: int) -> npt.NDArray[Any]:
    picture = decoded(path, how)
    if picture is None:
        raise ValueError(f"{path} is no picture that can be read")
    return picture


def decoded(path: Path, how: int) -> npt.NDArray[Any] | None:
    """Return the image that OpenCV decodes from a file with the flags of ``imread``, or None.

    The file is read here and OpenCV gets the bytes: a name that is not UTF-8 (from an old disk or another system) makes
    OpenCV terminate the process.

    Raises
    ------
    ValueError
        If the file is missing or may not be read, or the image has more pixels than OpenCV reads.
    """
    if not path.exists():
        raise ValueError(f"{path} does not exist")
    try:
        content = path.read_bytes() if path.is_file() else b""
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), how) if content else None
    except OSError as error:
        raise ValueError(f"{path} cannot be read: {error.strerror}") from error
    except cv2.error as error:  # more pixels than OpenCV reads
        raise ValueError(f"{path} cannot be read: {error.err} does not hold") from error
    return None if picture is None else np.asarray(picture)


def write_picture(path: Path, picture: npt.NDArray[Any]) -> None:
    """Write an image in the format of its name's suffix.

    ``imwrite`` does not detect that a small image did not fit on the disk, and terminates the process for a name that
    is not UTF-8.

    Raises
    ------
    ValueError
        If the format is unknown or cannot store the image, for example a grey format a colour image.
    OSError
        If the file cannot be written.
    """
    try:
        done, encoded = cv2.imencode(path.suffix, picture)
    except cv2.error as error:
        raise ValueError(f"{path} cannot be written: {error.err}") from error
    if not done:  # OpenCV 5 raises no error when encoding fails
        raise ValueError(f"{path} cannot be written: {path.suffix} holds no {picture.dtype} of shape {picture.shape}")
    write_file(path, encoded.tobytes())


def write_file(path: Path, data: bytes) -> None:
    """Write a file; name it in the ``OSError`` on failure, which the error of a full disk does not."""
    try:
        path.write_bytes(data)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


_LAYOUTS = (("img", "H1to{}p"), ("", "H_1_{}"))
"""Names of images and homographies: sequences of K. Mikolajczyk, and HPatches (V. Balntas et al., CVPR 2017)."""
_ENDINGS = (".txt", ".xml")
"""Suffixes of homography files; the second is OpenCV's, for the same sequences."""
_HPATCHES = {"i_": "HPatches light", "v_": "HPatches viewpoint"}


@dataclass(frozen=True, slots=True)
class ImageSequence:
    """Images of one plane: kind of change, first image, and by number the others with second_from_first (3, 3)."""

    change: str
    first: Path
    others: dict[int, Path]
    homographies: dict[int, npt.NDArray[np.float64]]

    def pairs(self) -> Iterator[HomographyPair]:
        """Read the pairs 1-2 to 1-n, which share the first image; the amount of change is the second image's number."""
        first = read_gray(self.first)
        for number, path in self.others.items():
            yield HomographyPair(self.change, float(number), first, read_gray(path), self.homographies[number])


def sequences(folder: Path) -> Iterator[ImageSequence]:
    """Yield the sequences below a folder: img1.., H1to2p.. (also .txt, .xml), or as HPatches 1.., H_1_2...

    The kind of change is the sequence's name; for HPatches it is light (i_...) or viewpoint (v_...).

    Raises
    ------
    ValueError
        If an image has no homography or a homography no image, or a homography is invalid.
    """
    for prefix, form in _LAYOUTS:
        # One folder at a time: it may hold its images in several formats.
        for place in sorted({p.parent for p in folder.rglob(f"{prefix}1.*") if p.suffix.lower() in SUFFIXES}):
            beside = sorted(place.iterdir())
            known = _numbered(form, {p.stem if p.suffix in _ENDINGS else p.name: p for p in beside})
            pictures = _numbered(f"{prefix}{{}}", {p.stem: p for p in beside if p.suffix.lower() in SUFFIXES})
            if not known:
                continue
            for number in sorted((known.keys() | {1}) ^ pictures.keys()):
                missing = form.format(number) if number in pictures else f"{prefix}{number}.*"
                raise ValueError(f"{place / missing} is missing")
            name = place.resolve().name.encode(errors="backslashreplace").decode()  # the name need not be UTF-8
            change = name if prefix else _HPATCHES.get(name[:2], name)
            homographies = {number: _homography(known[number]) for number in sorted(known)}
            yield ImageSequence(
                change, pictures[1], {number: pictures[number] for number in homographies}, homographies
            )


def _numbered(form: str, files: dict[str, Path]) -> dict[int, Path]:
    """Return the files whose name is ``form`` with a number at {}, by that number."""
    matches = ((re.fullmatch(re.escape(form).replace(r"\{\}", "([0-9]+)"), name), path) for name, path in files.items())
    return {int(match[1]): path for match, path in matches if match}


def _homography(path: Path) -> npt.NDArray[np.float64]:
    try:
        text = path.read_text()
        data = re.search("<data>(.*)</data>", text, re.DOTALL) if path.suffix == ".xml" else None
        values = np.array((data[1] if data else text).split(), np.float64)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error
    if values.shape != (9,) or not np.isfinite(values).all() or np.linalg.matrix_rank(values.reshape(3, 3)) < 3:
        raise ValueError(f"{path} is no homography; expected 3 x 3 finite numbers, and an inverse")
    return values.reshape(3, 3)
