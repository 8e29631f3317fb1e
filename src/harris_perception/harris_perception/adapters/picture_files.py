"""Pictures and sequences with known homographies from files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from harris_perception.core.repeatability import Pair

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".pgm", ".tif", ".tiff", ".webp")
"""Of the files in a folder that are taken for pictures, in small letters."""


def read_gray(path: Path) -> npt.NDArray[np.uint8]:
    """Read a picture as (H, W) uint8; one of more than 8 bits is stretched to its largest value.

    Raises
    ------
    ValueError
        If the file is missing, no picture, or has more pixels than OpenCV reads.
    """
    return _eight_bits(read_deep_gray(path))


def read_sensor_gray(path: Path) -> npt.NDArray[np.uint8]:
    """Read a picture as the sensor has it, however the camera was held (EXIF); else as :func:`read_gray`.

    A lens has its centre and its distortion on the sensor.
    """
    how = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    return _eight_bits(_stretched(_read(path, how)))


def read_deep_gray(path: Path) -> npt.NDArray[Any]:
    """Read a picture as (H, W) uint8, or float32 from 0 to 255 if it has more than 8 bits; raises as above.

    One in colour is stretched as :func:`read_bgr` does, so that the strengths of both are of one unit.
    """
    gray = _read(path, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH)
    if gray.dtype == np.uint8:
        return gray
    deep = _stretched(_read(path, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_ANYDEPTH))
    return deep if deep.ndim == 2 else cv2.cvtColor(deep, cv2.COLOR_BGR2GRAY)


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
    picture = decoded(path, how)
    if picture is None:
        raise ValueError(f"{path} is no picture that can be read")
    return picture


def decoded(path: Path, how: int) -> npt.NDArray[Any] | None:
    """Return what OpenCV reads of a file, by its flags for ``imread``, or None.

    OpenCV is given the bytes: a name that is not UTF-8 (of an old disk, or of another system) ends the process in it.

    Raises
    ------
    ValueError
        If the file is missing or may not be read, or has more pixels than OpenCV reads.
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
    """Write a picture in the format of its name's suffix.

    ``imwrite`` would not notice that a small one did not fit on the disk, and end the process by a name that is not
    UTF-8.

    Raises
    ------
    ValueError
        If the format is not known, or holds no such picture, as one for grey holds none in colour.
    OSError
        If the file cannot be written.
    """
    try:
        done, encoded = cv2.imencode(path.suffix, picture)
    except cv2.error as error:
        raise ValueError(f"{path} cannot be written: {error.err}") from error
    if not done:  # OpenCV 5 raises no error for what it finds on the way
        raise ValueError(f"{path} cannot be written: {path.suffix} holds no {picture.dtype} of shape {picture.shape}")
    write_file(path, encoded.tobytes())


def write_file(path: Path, data: bytes) -> None:
    """Write a file, and name it in the ``OSError`` if it cannot be: that of a full disk does not."""
    try:
        path.write_bytes(data)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


_LAYOUTS = (("img", "H1to{}p"), ("", "H_1_{}"))
"""Names of pictures and homographies: sequences of K. Mikolajczyk, and HPatches (V. Balntas et al., CVPR 2017)."""
_ENDINGS = (".txt", ".xml")
"""Which homographies may have; the second is OpenCV's, for the same sequences."""
_HPATCHES = {"i_": "HPatches light", "v_": "HPatches viewpoint"}


@dataclass(frozen=True, slots=True)
class Sequence:
    """Pictures of one plane: what changes, the first, and by number the others and second_from_first (3, 3) of each."""

    change: str
    first: Path
    others: dict[int, Path]
    homographies: dict[int, npt.NDArray[np.float64]]

    def pairs(self) -> Iterator[Pair]:
        """Read the pairs 1-2 to 1-n; their amount is the picture's number. All share one first picture."""
        first = read_gray(self.first)
        for number, path in self.others.items():
            yield Pair(self.change, float(number), first, read_gray(path), self.homographies[number])


def sequences(folder: Path) -> Iterator[Sequence]:
    """Yield the sequences below a folder: img1.., H1to2p.. (also .txt, .xml), or as HPatches 1.., H_1_2...

    What changes is a sequence's name; those of HPatches count together as light (i_...) and viewpoint (v_...).

    Raises
    ------
    ValueError
        If of a picture and its homography one is missing, or a homography is none.
    """
    for prefix, form in _LAYOUTS:
        # A folder at a time: its pictures may be there in several formats.
        for place in sorted({p.parent for p in folder.rglob(f"{prefix}1.*") if p.suffix.lower() in SUFFIXES}):
            beside = sorted(place.iterdir())
            known = _numbered(form, {p.stem if p.suffix in _ENDINGS else p.name: p for p in beside})
            pictures = _numbered(f"{prefix}{{}}", {p.stem: p for p in beside if p.suffix.lower() in SUFFIXES})
            if not known:
                continue
            for number in sorted((known.keys() | {1}) ^ pictures.keys()):
                missing = form.format(number) if number in pictures else f"{prefix}{number}.*"
                raise ValueError(f"{place / missing} is missing")
            name = place.resolve().name.encode(errors="backslashreplace").decode()  # it need not be UTF-8
            change = name if prefix else _HPATCHES.get(name[:2], name)
            homographies = {number: _homography(known[number]) for number in sorted(known)}
            yield Sequence(change, pictures[1], {number: pictures[number] for number in homographies}, homographies)


def _numbered(form: str, files: dict[str, Path]) -> dict[int, Path]:
    """Return those files of which the name is ``form`` with a number at {}, by that number."""
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
        raise ValueError(f"{path} is no homography: 3 x 3 finite numbers are needed, and an inverse")
    return values.reshape(3, 3)
