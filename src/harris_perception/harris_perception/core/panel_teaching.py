"""A new panel from a picture and a few places in it: the face seen straight on, and the text of a layout file."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from harris_perception.core.panel_template import px_from_mm
from harris_perception.core.planar_pose import inverse, map_points
from icu_common.core.geometry import Array
from icu_common.core.panel_layout import CONTROL_KINDS

Picture = npt.NDArray[np.uint8]


class TeachingError(ValueError):
    """What was given does not make a panel; the message names the value and what is needed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pointed:
    """A control that somebody pointed at: its foot's centre in the picture (px), and its size and height (mm)."""

    name: str
    kind: str
    pixel: tuple[float, float]
    size_mm: tuple[float, float]
    height_mm: float = 0.0


def parse_pointed(text: str) -> Pointed:
    """Read ``NAME:kind:u,v:WIDTHxHEIGHT[:height]``; pixels and mm.

    Raises
    ------
    TeachingError
    """
    parts = text.split(":")
    try:
        name, kind, pixel, size, *rest = parts
        u, v = (float(n) for n in pixel.split(","))
        width, height = (float(n) for n in size.split("x"))
        proud = float(rest[0]) if rest else 0.0
        if len(rest) > 1:
            raise ValueError
    except ValueError:
        raise TeachingError(f"control {text!r}: NAME:kind:u,v:WIDTHxHEIGHT[:height] is needed") from None
    if kind not in CONTROL_KINDS:
        raise TeachingError(f"control {text!r}: kind {kind!r} is none of {', '.join(CONTROL_KINDS)}")
    return Pointed(name=name, kind=kind, pixel=(u, v), size_mm=(width, height), height_mm=proud)


def mm_from_pixel(corners_px: npt.ArrayLike, size_mm: tuple[float, float]) -> Array:
    """Return the (3, 3) homography from the picture's pixels to the face's mm.

    Parameters
    ----------
    corners_px
        (4, 2) the face's corners in the picture: lower left, lower right, upper right, upper left.
    size_mm
        Width and height of the face.

    Raises
    ------
    TeachingError
        If the corners do not go round a face that is seen from the front.
    """
    corners = np.asarray(corners_px, dtype=np.float64)
    if corners.shape != (4, 2) or not np.isfinite(corners).all():
        raise TeachingError(f"{corners.tolist()}: four corners u,v are needed")
    side = np.roll(corners, -1, axis=0) - corners
    following = np.roll(side, -1, axis=0)
    turn = side[:, 0] * following[:, 1] - side[:, 1] * following[:, 0]
    if not (turn < -100.0).all():
        raise TeachingError(
            f"corners {corners.tolist()} do not go round the face: lower left, lower right, upper right, upper left"
        )
    width, height = size_mm
    face = np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])
    return np.asarray(cv2.getPerspectiveTransform(corners.astype(np.float32), face.astype(np.float32)), np.float64)


def straight_on(picture: Picture, to_mm: Array, size_mm: tuple[float, float], px_per_mm: float) -> Picture:
    """Return the face seen straight on, from edge to edge: what recognition takes as ``template``."""
    width, height = (round(side * px_per_mm) for side in size_mm)
    if not (min(width, height) >= 48 and max(width, height) <= 8192):
        raise TeachingError(f"{width} x {height} px at {px_per_mm:g} px/mm: sides from 48 to 8192 px are needed")
    picture_from_template = inverse(to_mm) @ inverse(px_from_mm(height, px_per_mm))
    flags = cv2.INTER_AREA | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpPerspective(picture, picture_from_template, (width, height), flags=flags), np.uint8)


def layout_text(model: str, title: str, size_mm: tuple[float, float], controls: list[Pointed], to_mm: Array) -> str:
    """Return the text of a layout file with these controls; its artwork is empty, the template shows the print."""
    places = map_points(to_mm, np.array([c.pixel for c in controls]).reshape(-1, 2))
    entries: list[dict[str, Any]] = []
    for control, (x, y) in zip(controls, places):
        entry: dict[str, Any] = {
            "name": control.name,
            "kind": control.kind,
            "position_mm": [round(float(x), 2), round(float(y), 2)],
            "size_mm": list(control.size_mm),
            "height_mm": control.height_mm,
        }
        if control.kind in ("knob", "connector"):
            entry["shape"] = "circle"
        entries.append(entry)
    document = {"model": model, "title": title, "size_mm": list(size_mm), "controls": entries}
    return yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=120)
