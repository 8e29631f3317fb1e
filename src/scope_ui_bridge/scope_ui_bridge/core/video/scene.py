"""Positions of the panel, its controls, the stylus and the target in the image, in raw pixels."""

from __future__ import annotations

import unicodedata
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from icu_common.core.geometry import frames
from icu_common.core.geometry.camera_model import CameraModel, StereoModel
from icu_common.core.geometry.geometry import Array, Plane, Transform
from scope_ui_bridge.core.video.layers import Layers

_EDGE_POINTS = 8  # per edge of the panel, so that lens distortion shows
_CIRCLE_POINTS = 24
_REDRAW_M = 0.0001  # a fifth of a pixel on the bench; smaller changes are noise of the pose
_PROBES = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.3, 0.0]])
_TIP_LIFE_NS = 500_000_000  # maximum age of a tip that is drawn


def labels_of(names: Iterable[str], written: Mapping[str, str]) -> dict[str, str]:
    """Return each control's label by name: as ``written`` in the layout, or made from its name.

    Equal labels get the name appended, so that people do not confuse the controls.
    """
    labels = {name: written.get(name, "").strip() for name in names}
    for name, label in labels.items():
        if not any(unicodedata.category(sign)[0] in "LNPS" for sign in label):  # the label is invisible
            labels[name] = name.replace("_", " ").capitalize()
    alike = Counter(label.casefold() for label in labels.values())
    return {name: label if alike[label.casefold()] == 1 else f"{label} ({name})" for name, label in labels.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Face:
    """The top face of a control in panel_link: ``centre`` (3,) m with its height, ``size`` (width, height) m."""

    name: str
    kind: str
    label: str
    circle: bool
    centre: tuple[float, float, float]
    size: tuple[float, float]

    def contains(self, point: Array) -> bool:
        """Return whether a point (x, y in m, panel_link) lies on the face."""
        x, y = (np.asarray(point)[:2] - self.centre[:2]) / self.size * 2
        return bool(x * x + y * y <= 1) if self.circle else bool(max(abs(x), abs(y)) <= 1)

    def outline(self) -> Array:
        """Return (N, 3) points in metres around the face, in panel_link."""
        if self.circle:
            turn = np.linspace(0.0, 2 * np.pi, _CIRCLE_POINTS, endpoint=False)
            xy = np.column_stack([np.cos(turn), np.sin(turn)]) / 2
        else:
            xy = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
        flat = xy * self.size + self.centre[:2]
        return np.column_stack([flat, np.full(len(flat), self.centre[2])])


@dataclass(slots=True)
class VideoScene:
    """Newest geometry; ``version`` increases with each change of the panel, a control or a camera.

    Points are in camera_left_optical_frame (rectified), except for the faces and the panel's ``outline``, (N, 2) m,
    both in panel_link, the target (any frame), and the tip's current ``path``, (N, 3) m in base_link.
    """

    left: CameraModel | None = None
    right: CameraModel | None = None
    camera_from_panel: Transform | None = None
    camera_from_base: Transform | None = None
    faces: tuple[Face, ...] = ()
    outline: Array | None = None
    tip: Array | None = None
    tip_ns: int = 0
    target: tuple[str, Array] | None = None
    path: Array | None = None
    layers: Layers = field(default_factory=Layers)
    version: int = 0
    _drawn: Transform | None = field(default=None, init=False)
    _stereo: StereoModel | None = field(default=None, init=False)
    _panels: dict[str, dict[str, Any]] = field(default_factory=dict, init=False)

    def changed(self) -> None:
        """Discard the cached panel; call after a change of anything that :meth:`panel` returns."""
        self.version += 1
        self._panels.clear()
        self._stereo = None

    def place_panel(self, camera_from_panel: Transform) -> None:
        """Set the pose of the panel; the drawn outlines change only if the panel has visibly moved."""
        self.camera_from_panel = camera_from_panel
        drawn = self._drawn
        if drawn is None or np.abs(camera_from_panel.apply(_PROBES) - drawn.apply(_PROBES)).max() > _REDRAW_M:
            self._drawn = camera_from_panel
            self.changed()

    def project(self, camera: str, points: npt.ArrayLike) -> Array | None:
        """Project (N, 3) points of camera_left_optical_frame to raw pixels (N, 2); None without a calibration."""
        if camera == "left":
            return None if self.left is None else self.left.project(points)
        if self.left is None or self.right is None:
            return None
        if self._stereo is None:
            self._stereo = StereoModel(left=self.left, right=self.right)
        return self._stereo.project_right(points)

    def panel(self, camera: str) -> dict[str, Any]:
        """Return the outline of the panel and its controls, each with outline and box in pixels.

        A control that is not completely inside the image is left out. ``missing`` is the reason why the panel cannot be
        drawn at all: the cameras' calibration or a pose.
        """
        if camera not in self._panels:
            self._panels[camera] = {"version": self.version, **self._build(camera)}
        return self._panels[camera]

    def _build(self, camera: str) -> dict[str, Any]:
        model = self.left if camera == "left" else self.right
        if model is None or self.left is None:  # positions are given in the left camera's frame
            return {"outline": [], "controls": [], "missing": "camera"}
        if self._drawn is None:
            return {"outline": [], "controls": [], "missing": "panel"}
        controls = []
        outlines = [face.outline() for face in self.faces]
        stacked = np.vstack(outlines) if outlines else np.empty((0, 3))
        pixels = self.project(camera, self._drawn.apply(stacked))
        assert pixels is not None
        ends = np.cumsum([len(outline) for outline in outlines])
        for face, part in zip(self.faces, np.split(pixels, ends[:-1])):
            low, high = part.min(axis=0), part.max(axis=0)
            if not (np.isfinite(part).all() and (low >= 0).all() and (high <= np.array(model.size) - 1).all()):
                continue
            box = [*low, *(high - low)]
            controls.append(
                {
                    "name": face.name,
                    "kind": face.kind,
                    "label": face.label,
                    "outline": _rounded(part),
                    "box": [round(float(v), 1) for v in box],
                }
            )
        return {"outline": self._panel_outline(camera), "controls": controls, "missing": ""}

    def _panel_outline(self, camera: str) -> list[list[float]]:
        if self.outline is None or len(self.outline) < 2 or self._drawn is None:
            return []
        along = np.linspace(0, 1, _EDGE_POINTS, endpoint=False)[:, None]
        edge = np.vstack([a + along * (b - a) for a, b in pairwise(self.outline)])
        pixels = self.project(camera, self._drawn.apply(np.column_stack([edge, np.zeros(len(edge))])))
        return [] if pixels is None or not np.isfinite(pixels).all() else _rounded(pixels)

    def on_panel(self, point: Array) -> bool:
        """Return whether a point of panel_link lies within the panel's extent; True if the extent is unknown."""
        if self.outline is None:
            return True
        low, high = self.outline.min(axis=0), self.outline.max(axis=0)
        return bool((point[:2] >= low).all() and (point[:2] <= high).all())

    def moving_parts(self, camera: str, stamp_ns: int) -> dict[str, Any]:
        """Return stylus tip and target in pixels for the image with this stamp (null = not seen)."""
        fresh = abs(stamp_ns - self.tip_ns) < _TIP_LIFE_NS
        return {
            "tip": self._pixel(camera, self.tip if fresh else None),
            "target": self._pixel(camera, self._target_in_camera()),
        }

    def base_line(self, camera: str, points: Array | None) -> list[list[float]]:
        """Return the pixels of (N, 3) points of base_link; empty without a calibration."""
        if points is None or self.camera_from_base is None:
            return []
        pixels = self.project(camera, self.camera_from_base.apply(points))
        return [] if pixels is None or not np.isfinite(pixels).all() else _rounded(pixels)

    def way_to(self, start: Array, anchors: Array) -> Array | None:
        """Return a path (N, 3) m in base_link: up from the tip at ``start``, across, down to the first anchor, to the
        rest.

        ``anchors`` are (M, 3) m in panel_link. The controller moves on this path, except for the last millimetre, in
        which it takes up the backlash.
        """
        if self.camera_from_base is None or self.camera_from_panel is None:
            return None
        ends = self.camera_from_base.inverse().apply(self.camera_from_panel.apply(anchors))
        return np.vstack([start, [*start[:2], 0.0], [*ends[0, :2], 0.0], ends])

    def _pixel(self, camera: str, point: Array | None) -> list[float] | None:
        pixels = None if point is None else self.project(camera, point)
        return None if pixels is None or not np.isfinite(pixels).all() else _rounded(pixels)[0]

    def _target_in_camera(self) -> Array | None:
        if self.target is None:
            return None
        frame, point = self.target
        camera_from = {
            frames.CAMERA_LEFT: Transform.identity(),
            frames.PANEL: self.camera_from_panel,
            frames.BASE: self.camera_from_base,
        }.get(frame)
        return None if camera_from is None else camera_from.apply(point)

    def panel_point(self, pixel: tuple[float, float], height_m: float = 0.0) -> Array | None:
        """Return (3,) m in panel_link: where a left raw pixel's ray meets the panel's face or a plane above it."""
        if self.left is None or self.camera_from_panel is None:
            return None
        pose = self.camera_from_panel
        try:
            point = Plane.through(pose.apply([0.0, 0.0, height_m]), pose.rotation[:, 2]).intersect_ray(
                np.zeros(3), self.left.rays([pixel])[0]
            )
        except ValueError:
            return None
        return pose.inverse().apply(point)

    def face(self, name: str) -> Face | None:
        """Return the control with this name."""
        return next((face for face in self.faces if face.name == name), None)


def moved_m(before: Transform, now: Transform, point_in_panel: npt.ArrayLike) -> float:
    """Return the distance in metres between a panel point's positions at two poses of the panel."""
    return float(np.linalg.norm(now.apply(point_in_panel) - before.apply(point_in_panel)))


def _rounded(pixels: Array) -> list[list[float]]:
    return [[round(float(u), 1), round(float(v), 1)] for u, v in pixels]
