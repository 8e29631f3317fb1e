"""Panel and bench at the arrival of a goal: controls, their outlines, and the first surface on a line of sight.

All points are in metres.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from icu_common.core.alignment.findings import Cause
from icu_common.core.geometry.camera_model import CameraModel
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_layout import Control, Dimple
from icu_common.core.reasons.message import Message, quoted


class TargetRefused(ValueError):
    """The goal cannot be carried out; the message names the value and the limit.

    ``delay`` is given if only lateness, or a finding about the cameras or the layout, is the cause.
    """

    def __init__(self, reason: str, delay: Cause | None = None) -> None:
        super().__init__(reason)
        self.delay = delay


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PanelControl:
    """One control as recognition reports it: centre (2,) and size (2,) in panel_link, height above the face, metres.

    A knob's dimple is in mm, as in its layout.
    """

    name: str
    kind: str
    centre: Array
    size: Array
    height: float
    round: bool = False
    dimple: Dimple | None = None

    def gap(self, xy: Array) -> float:
        """Return the distance in metres from (2,) to the control's outline in the face's plane, 0 inside."""
        offset = np.asarray(xy) - self.centre
        if self.round:
            reach = float(np.linalg.norm(offset / (self.size / 2)))
            return max(0.0, 1 - 1 / reach) * float(np.linalg.norm(offset)) if reach > 0 else 0.0
        return float(np.linalg.norm(np.maximum(np.abs(offset) - self.size / 2, 0.0)))

    def entry(self, top: Array, bottom: Array) -> float | None:
        """Return the fraction (0 to 1) of the line from ``top`` to ``bottom`` (2,) at which it first meets the outline.

        None: it never does.
        """
        start: Array = (top - self.centre) / (self.size / 2)
        way: Array = (bottom - top) / (self.size / 2)
        return _enter_circle(start, way) if self.round else _enter_square(start, way)


def _enter_circle(start: Array, way: Array) -> float | None:
    a, b, c = float(way @ way), float(start @ way), float(start @ start) - 1.0
    if c <= 0:
        return 0.0
    root = b * b - a * c
    if a == 0 or root < 0:
        return None
    first = (-b - math.sqrt(root)) / a
    return first if 0 <= first <= 1 else None


def _enter_square(start: Array, way: Array) -> float | None:
    # Slab method (Kay and Kajiya 1986) for the square from -1 to 1.
    near, far = 0.0, 1.0
    for s, w in zip(start, way):
        if w == 0:
            if abs(s) > 1:
                return None
            continue
        low, high = sorted(((-1 - s) / w, (1 - s) / w))
        near, far = max(near, low), min(far, high)
    return near if near <= far else None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PanelMap:
    """Controls of the panel, and its extent (2, 2): minimum and maximum x, y of its face in metres."""

    controls: tuple[PanelControl, ...]
    extent: Array

    @classmethod
    def of(cls, controls: Sequence[Control], outline: Array) -> PanelMap:
        """Return the map of a layout's controls (in mm) and an outline (N, 2) in metres."""
        mine = (
            PanelControl(
                name=c.name,
                kind=c.kind,
                centre=np.array(c.position_mm) / 1000,
                size=np.array(c.size_mm) / 1000,
                height=c.height_mm / 1000,
                round=c.shape == "circle",
                dimple=c.dimple,
            )
            for c in controls
        )
        return cls(controls=tuple(mine), extent=np.array([outline.min(axis=0), outline.max(axis=0)]))


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Scene:
    """State of the bench at the acceptance of a goal; it does not change until the goal ends."""

    camera_from_base: Transform
    camera_from_panel: Transform
    base_from_reading: Array
    panel: PanelMap
    camera: CameraModel

    @property
    def base_from_panel(self) -> Transform:
        return self.camera_from_base.inverse() @ self.camera_from_panel

    def control(self, name: str) -> PanelControl:
        """Return the control with that name.

        Raises
        ------
        TargetRefused
            If there is none; the message names the most similar ones.
        """
        for control in self.panel.controls:
            if control.name == name:
                return control
        names = [c.name for c in self.panel.controls]
        near = difflib.get_close_matches(name.upper(), names, n=3, cutoff=0.4) or names[:5]
        raise TargetRefused(Message("panel.unknown_control_nearest", name=quoted(name), near=", ".join(near)))

    def first_hit(self, origin: Array, direction: Array) -> tuple[Array, PanelControl | None]:
        """Return the surface point (3,) that a ray in panel_link meets first, and the control it belongs to.

        If the ray meets the side of a control, the point is the centre of the control's top.

        Raises
        ------
        TargetRefused
            If the ray does not meet the panel.
        """
        if not (origin[2] > 0 and direction[2] < 0):
            raise TargetRefused(Message("panel.line_sight_not_meet_panel"))

        def at(height: float) -> Array:
            point: Array = origin + (height - origin[2]) / direction[2] * direction
            return point

        face = at(0.0)
        hits: list[tuple[float, Array, PanelControl]] = []
        for control in self.panel.controls:
            top = at(control.height)
            way = control.entry(top[:2], face[:2])
            if way is not None:
                point = top if way == 0 else np.array([*control.centre, control.height])
                hits.append((control.height * (1 - way), point, control))
        # The highest entry is the nearest to the viewer; of nested flat areas the smallest one is selected.
        hits.sort(key=lambda hit: (-hit[0], float(np.prod(hit[2].size))))
        return (hits[0][1], hits[0][2]) if hits else (face, None)
