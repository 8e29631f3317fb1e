"""Makes a new panel from an image and some points in it: the face seen straight on, and the text of a layout file."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from harris_perception.core.pose.planar_pose import inverse, map_points
from harris_perception.core.recognition.panel_template import edge_to_edge
from harris_perception.core.recognition.recognition import PanelRecogniser
from icu_common.core.configuration.text_bounds import deepest_line, plain
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array
from icu_common.core.panel.panel_layout import CONTROL_KINDS, PanelLayout, parse_layout
from icu_common.core.reasons.message import Message, quoted

_MODEL = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,40}\Z")  # used as a file name

MAX_REQUEST, MAX_DEPTH = 64 * 1024, 12
"""Maximum number of characters and of open brackets of a request, both checked before it is parsed."""
Picture = npt.NDArray[np.uint8]


class TeachingError(ValueError):
    """The input does not describe a panel; the message names the value and the requirement.

    ``goal_id`` is the request's id if it could be read, else empty.
    """

    def __init__(self, message: str, goal_id: str = "") -> None:
        super().__init__(message)
        self.goal_id = goal_id


@dataclass(frozen=True, slots=True, kw_only=True)
class Pointed:
    """A control selected by a user: its foot's centre in the image (px), and its size and height (mm)."""

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
        raise TeachingError(Message("teach.control_name_kind_widthxheight_height", text=quoted(text))) from None
    return _known_kind(Pointed(name=name, kind=kind, pixel=(u, v), size_mm=(width, height), height_mm=proud))


def _known_kind(control: Pointed) -> Pointed:
    if control.kind not in CONTROL_KINDS:
        raise TeachingError(
            Message(
                "teach.control_kind_none",
                control=quoted(control.name),
                kind=quoted(control.kind),
                control_kinds=", ".join(CONTROL_KINDS),
            )
        )
    return control


def mm_from_pixel(corners_px: npt.ArrayLike, size_mm: tuple[float, float]) -> Array:
    """Return the (3, 3) homography from the image's pixels to the face's mm.

    Parameters
    ----------
    corners_px
        (4, 2) the face's corners in the image: lower left, lower right, upper right, upper left.
    size_mm
        Width and height of the face.

    Raises
    ------
    TeachingError
        If the corners are not in the order of a face seen from the front.
    """
    corners = np.asarray(corners_px, dtype=np.float64)
    if corners.shape != (4, 2) or not np.isfinite(corners).all():
        raise TeachingError(Message("teach.four_corners_needed", corners=corners.tolist()))
    side = np.roll(corners, -1, axis=0) - corners
    following = np.roll(side, -1, axis=0)
    turn = side[:, 0] * following[:, 1] - side[:, 1] * following[:, 0]
    if not (turn < -100.0).all():
        raise TeachingError(Message("teach.corners_not_go_round_face", corners=corners.tolist()))
    width, height = size_mm
    face = np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])
    return np.asarray(cv2.getPerspectiveTransform(corners.astype(np.float32), face.astype(np.float32)), np.float64)


def straight_on(picture: Picture, to_mm: Array, size_mm: tuple[float, float], px_per_mm: float) -> Picture:
    """Return the face seen straight on, from edge to edge: the ``template`` for recognition.

    Parameters
    ----------
    picture
        (H, W, 3) uint8 BGR.
    to_mm
        (3, 3) homography from the image's pixels to millimetres of the face.
    size_mm, px_per_mm
        Size of the face, and scale of the result.

    Raises
    ------
    TeachingError
        If a side would have fewer than 48 or more than 8192 pixels.
    """
    wide, high = (side * px_per_mm for side in size_mm)
    if not all(math.isfinite(side) and 48 <= round(side) <= 8192 for side in (wide, high)):
        raise TeachingError(Message("teach.sides_48_8192_needed", wide=wide, high_px=high, px_per_mm=px_per_mm))
    width, height = round(wide), round(high)
    picture_from_template = inverse(to_mm) @ inverse(edge_to_edge((width, height), size_mm))
    flags = cv2.INTER_AREA | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpPerspective(picture, picture_from_template, (width, height), flags=flags), np.uint8)


def layout_text(model: str, title: str, size_mm: tuple[float, float], controls: list[Pointed], to_mm: Array) -> str:
    """Return the text of a layout file with these controls; its artwork is empty, since the template has the print."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Lesson:
    """Description of a panel: its names and size (mm), its corners (4, 2) and controls in the image (raw pixels).

    Raises
    ------
    TeachingError
        If the model is no valid file name.
    """

    model: str
    title: str
    size_mm: tuple[float, float]
    corners_px: Array
    controls: tuple[Pointed, ...]
    px_per_mm: float = 4.0

    def __post_init__(self) -> None:
        if not _MODEL.match(self.model):
            raise TeachingError(Message("teach.model_letter_then_up_40", model=quoted(self.model)))


@dataclass(frozen=True, slots=True, kw_only=True)
class TeachingRequest:
    """A lesson received as a message: the id of its sender's request, and the stamp of its image."""

    goal_id: str
    stamp_ns: int
    lesson: Lesson


def parse_request(text: str) -> TeachingRequest:
    """Read JSON: id, stamp (ns, as a text), model, title, size_mm, corners and controls.

    A control is [name, kind, u, v, width, height, height above the face]; pixels and mm.

    Raises
    ------
    TeachingError
    """
    goal_id = ""
    if len(text) > MAX_REQUEST or deepest_line(text, MAX_DEPTH):
        raise TeachingError(
            Message("teach.request_not_understood_more_characters", max_request=MAX_REQUEST, max_depth=MAX_DEPTH)
        )
    try:
        given = json.loads(text)
        # JSON may contain half of a surrogate pair, which no message can carry.
        goal_id = plain(str(given["id"]).encode().decode(), 80)
        pointed = []
        for name, kind, *numbers in given["controls"]:
            u, v, wide, high, proud = (float(n) for n in numbers)
            control = Pointed(name=str(name), kind=str(kind), pixel=(u, v), size_mm=(wide, high), height_mm=proud)
            pointed.append(_known_kind(control))
        width, height = (float(side) for side in given["size_mm"])
        lesson = Lesson(
            model=str(given["model"]),
            title=str(given["title"]) or str(given["model"]),
            size_mm=(width, height),
            corners_px=np.array(given["corners"], dtype=np.float64),
            controls=tuple(pointed),
        )
        return TeachingRequest(goal_id=goal_id, stamp_ns=int(given["stamp"]), lesson=lesson)
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as error:
        reason = str(error)
        if not isinstance(error, TeachingError):
            reason = Message("teach.not_understood", kind=type(error).__name__, error=plain(reason))
        raise TeachingError(reason, goal_id) from error


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Taught:
    """A panel that recognition can find: its layout, the text of its file, and its face seen straight on."""

    layout: PanelLayout
    text: str
    template: Picture
    px_per_mm: float


def teach(picture: Picture, lesson: Lesson, camera: CameraModel | None = None) -> Taught:
    """Return the panel that a lesson describes, after checking that it can be recognised.

    Parameters
    ----------
    picture
        (H, W) or (H, W, C), raw.
    lesson
        Points in it.
    camera
        The camera that took it, to remove its distortion; None if unknown.

    Raises
    ------
    ValueError
        With the value and the bound.
    """
    corners, controls = lesson.corners_px, list(lesson.controls)
    if camera is not None:
        # The camera's own image without distortion and skew, not rotated like the pair's.
        straight = np.column_stack([camera.k, np.zeros(3)])
        straight[0, 1] = 0.0
        camera = dataclasses.replace(camera, r=np.eye(3), p=straight)
        picture = np.asarray(cv2.remap(picture, *camera.rectification_maps(), cv2.INTER_LINEAR), np.uint8)
        corners = _straightened(corners, camera)
        places = _straightened(np.array([c.pixel for c in controls]).reshape(-1, 2), camera)
        controls = [
            Pointed(name=c.name, kind=c.kind, pixel=(u, v), size_mm=c.size_mm, height_mm=c.height_mm)
            for c, (u, v) in zip(controls, places.tolist())
        ]
    to_mm = mm_from_pixel(corners, lesson.size_mm)
    template = straight_on(picture, to_mm, lesson.size_mm, lesson.px_per_mm)
    text = layout_text(lesson.model, lesson.title, lesson.size_mm, controls, to_mm)
    layout = parse_layout(text, f"{lesson.model}.yaml")
    PanelRecogniser(layout, picture=template, picture_px_per_mm=lesson.px_per_mm)  # ValueError: too little print
    return Taught(layout=layout, text=text, template=template, px_per_mm=lesson.px_per_mm)


def _straightened(pixels: Array, camera: CameraModel) -> Array:
    """Return the positions of raw pixels (N, 2) in the image without distortion."""
    straight = camera.rectify(pixels)
    for u, v in pixels[~np.isfinite(straight).all(axis=1)]:
        raise TeachingError(Message("teach.pixel_beyond_camera_calibration_reaches", u=u, v=v))
    return straight
