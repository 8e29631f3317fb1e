"""A panel's controls and their visible state as messages, and back."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import (
    Point,
    Vector3,
)
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from icu_common.core.configuration.text_bounds import plain
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.core.panel.panel_layout import Control, Dimple, PanelLayout, rgb
from icu_common.core.panel.panel_state import HIDDEN_BY, ControlSeen, PanelSeen
from icu_common.nodes.messages.heads import MAX_NAME, stamp_ns
from icu_common.nodes.messages.places import pose
from icu_common.nodes.messages.results import diagnostic_status, pairs_of

MAX_CONTROLS = 400
"""Maximum number of controls of a panel."""

_SHAPES = {"rectangle": Marker.CUBE, "circle": Marker.CYLINDER}


_OUTLINE = "outline"


def panel_state_message(seen: PanelSeen, head: Header) -> DiagnosticArray:
    """Pack the visible state of a panel: one status for each control, with its name, text for people, and values."""
    message = DiagnosticArray(header=head)
    for control in seen.controls:
        values: list[tuple[str, Any]] = [("kind", control.kind), ("hidden_by", control.hidden_by)]
        if control.lamp:
            values.append(("lamp", control.lamp))
        if not math.isnan(control.angle_deg):
            values.append(("angle_deg", f"{control.angle_deg:.2f}"))
        if control.changed_ns:
            values.append(("changed_ns", control.changed_ns))
        if control.detent_deg:
            values.append(("detent_deg", f"{control.detent_deg:g}"))
        values += [(f"mark {name}", f"{degrees:g}") for name, degrees in control.marks]
        level = "warn" if control.hidden_by == "something" else "ok"
        message.status.append(diagnostic_status(control.name, level, control.text(), values))
    return message


def panel_state_of_message(message: DiagnosticArray) -> PanelSeen:
    """Unpack the visible state of a panel.

    Raises
    ------
    ValueError
        If a control's values are missing or wrong.
    """
    controls = []
    for status in message.status[:MAX_CONTROLS]:
        name, values = plain(status.name, MAX_NAME), pairs_of(status)
        try:
            controls.append(
                ControlSeen(
                    name=name,
                    kind=values["kind"],
                    hidden_by=HIDDEN_BY[HIDDEN_BY.index(values["hidden_by"])],
                    lamp=values.get("lamp", ""),
                    angle_deg=float(values.get("angle_deg", "nan")),
                    changed_ns=int(values.get("changed_ns", "0")),
                    detent_deg=float(values.get("detent_deg", "0")),
                    marks=tuple((k[5:], float(v)) for k, v in values.items() if k.startswith("mark ")),
                )
            )
        except (KeyError, ValueError) as error:
            raise ValueError(f"control {name!r}: {error}") from error
    return PanelSeen(stamp_ns=stamp_ns(message.header.stamp), controls=tuple(controls))


def controls_message(layout: PanelLayout, head: Header) -> MarkerArray:
    """Pack a panel's controls and its outline; ``head`` names the panel's frame.

    One marker per control: ``ns`` is its kind, ``text`` its name, ``id`` its number, position the centre of its top
    face, and scale (width, height, protrusion), all in metres. A knob with a dimple has ``points``: the middle of the
    dimple's bottom and a point of its rim. They are relative to the middle of the knob's top while the marker points
    up. The last marker is the outline as a line strip.
    """
    markers = []
    for number, control in enumerate(layout.controls):
        marker = Marker(header=head, ns=control.kind, id=number, type=_SHAPES[control.shape], text=control.name)
        x, y, z = (v * 1e-3 for v in (*control.position_mm, control.height_mm))
        marker.pose = pose(Transform(np.eye(3), np.array([x, y, z])))
        marker.scale = Vector3(x=control.size_mm[0] * 1e-3, y=control.size_mm[1] * 1e-3, z=z)
        if control.dimple is not None:
            x, y, rim = (v * 1e-3 for v in (*control.dimple.place_mm, control.dimple.diameter_mm / 2))
            marker.points = [Point(x=x, y=y, z=-control.dimple.depth_mm * 1e-3), Point(x=x + rim, y=y, z=0.0)]
        red, green, blue = (v / 255 for v in rgb(control.colour))
        marker.color = ColorRGBA(r=red, g=green, b=blue, a=0.8)
        markers.append(marker)
    outline = Marker(header=head, ns=_OUTLINE, id=0, type=Marker.LINE_STRIP, text=layout.model)
    outline.pose = pose(Transform.identity())
    outline.scale.x = 0.001
    outline.color = ColorRGBA(r=1.0, g=0.8, b=0.0, a=1.0)
    width, height = (v * 1e-3 for v in layout.size_mm)
    corners = ((0.0, 0.0), (width, 0.0), (width, height), (0.0, height), (0.0, 0.0))
    outline.points = [Point(x=x, y=y, z=0.0) for x, y in corners]
    return MarkerArray(markers=[*markers, outline])


def _dimple(marker: Marker) -> Dimple | None:
    if not marker.points:
        return None
    if len(marker.points) != 2:
        raise ValueError(f"marker {marker.text!r} has {len(marker.points)} points, none or a dimple's two are known")
    bottom, rim = marker.points
    return Dimple(
        place_mm=(bottom.x * 1e3, bottom.y * 1e3),
        diameter_mm=2e3 * float(np.hypot(rim.x - bottom.x, rim.y - bottom.y)),
        depth_mm=(rim.z - bottom.z) * 1e3,
    )


def controls_of_message(message: MarkerArray) -> tuple[tuple[Control, ...], Array]:
    """Unpack the controls (in mm, as in the layout file) and the outline, (N, 2) in metres on the panel's face.

    Raises
    ------
    ValueError
        If a marker has no name or there is no outline.
    """
    shapes = {number: name for name, number in _SHAPES.items()}
    controls = []
    outline = np.empty((0, 2))
    for marker in message.markers:
        if marker.ns == _OUTLINE:
            outline = np.array([(p.x, p.y) for p in marker.points])
            continue
        if not marker.text:
            raise ValueError(f"marker {plain(marker.ns, MAX_NAME)!r} {marker.id} has no name")
        top, scale = marker.pose.position, marker.scale
        controls.append(
            Control(
                name=plain(marker.text, MAX_NAME),
                kind=plain(marker.ns, MAX_NAME),
                position_mm=(top.x * 1e3, top.y * 1e3),
                size_mm=(scale.x * 1e3, scale.y * 1e3),
                shape=shapes.get(marker.type, "rectangle"),
                height_mm=top.z * 1e3,
                dimple=_dimple(marker),
            )
        )
    if len(outline) < 4:
        raise ValueError("the controls came without the panel's outline")
    return tuple(controls), outline
