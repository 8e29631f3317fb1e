"""Conversion of a control's name, a panel point, a pixel or a base point to the position where the ball touches.

All points are in metres. The tip of the stylus is the centre of its ball; the ball's lowest point, one radius below
along base z, makes contact.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gantry_driver.core.motion.scene import PanelControl, Scene, TargetRefused
from icu_common.core.configuration.config import Config, setting
from icu_common.core.geometry.frames import BASE, CAMERA_LEFT, PANEL
from icu_common.core.geometry.geometry import Array
from icu_common.core.panel.gesture import TURNING, Gesture, Point
from icu_common.core.panel.panel_layout import Dimple
from icu_common.core.reasons.message import Message, quoted

TURNABLE = ("knob",)
DRAGGABLE = ("touch_area",)
UNTOUCHABLE = ("connector",)
SINKING = ("button",)
DRAG_STEP_M = 0.005
MOST_BIAS_DEG = 10.0
"""Maximum lost motion that counts as mechanical play; with more, the knob does not follow the stylus."""
FRAMES = (BASE, PANEL, CAMERA_LEFT)
_PROUD_M = 5e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class TouchConfig(Config):
    """Shape of the stylus, and geometry of its contact with the panel."""

    ball_radius_m: float = setting(0.002, "Radius of the ball at the tip", minimum=1e-4, maximum=0.02, unit="m")
    shaft_radius_m: float = setting(0.0025, "Radius of the shaft above the ball", minimum=1e-4, maximum=0.02, unit="m")
    hover_m: float = setting(
        0.008, "Height of the ball's bottom above the surface during a look", minimum=0.001, maximum=0.05, unit="m"
    )
    overtravel_m: float = setting(
        0.001, "Depth to which a touch presses into the surface", minimum=0.0, maximum=0.01, unit="m"
    )
    side_clearance_m: float = setting(
        0.001, "Minimum lateral gap between the stylus and a raised neighbour", minimum=0.0, maximum=0.02, unit="m"
    )
    top_clearance_m: float = setting(
        0.003,
        "Minimum height of the ball's bottom above neighbours while hovering",
        minimum=0.0,
        maximum=0.02,
        unit="m",
    )
    turn_radius_fraction: float = setting(
        0.6, "Radius at which a knob's top is pushed, as a fraction of the knob's radius", minimum=0.1, maximum=0.95
    )
    max_tilt_deg: float = setting(
        10.0, "Maximum angle between the panel's normal and the stylus", minimum=0.0, maximum=45.0, unit="deg"
    )
    turn_step_deg: float = setting(
        2.0, "Maximum angle of one chord of a turn's arc", minimum=0.1, maximum=10.0, unit="deg"
    )

    def side_needed_m(self) -> float:
        """Return the minimum distance of a raised neighbour from the tip's axis, in metres."""
        return max(self.ball_radius_m, self.shaft_radius_m) + self.side_clearance_m


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Touch:
    """One position to touch.

    Parameters
    ----------
    control
        Name of the control, empty on the bare face.
    in_panel, in_base
        (3,) the point on the surface.
    hover_z, touch_z
        Base z of the ball's centre during a look, and at the end of the touch.
    arc
        (N, 3) further centres of the ball in base_link, for a turn or a drag; (0, 3) otherwise.
    key
        Whether the touched control gives way.
    """

    control: str
    in_panel: Array
    in_base: Array
    hover_z: float
    touch_z: float
    arc: Array
    key: bool = False


def resolve(
    gesture: Gesture,
    scene: Scene,
    config: TouchConfig,
    *,
    wander_m: float,
    turn_deg: float = math.nan,
    knob_deg: float = math.nan,
    key_travel_m: float = 0.0,
) -> Touch:
    """Return the touch of a gesture.

    Parameters
    ----------
    gesture
        Kind and target.
    scene
        Poses, controls, calibration.
    config
        Settings of the stylus.
    wander_m
        Maximum lateral distance of the hovering tip from the target before a correction.
    turn_deg
        Angle by which to turn a knob, counter-clockwise positive; NaN for the angle in the gesture.
    knob_deg
        Angle of the knob's marker, counter-clockwise from up; NaN if unknown.
    key_travel_m
        Maximum travel of a key.

    Raises
    ------
    TargetRefused
        If the control is unknown or must not be touched, or the gesture does not suit it. Also if the point is not on
        the panel, the panel is tilted too far, or a raised neighbour is in the way.
    """
    base_from_panel = scene.base_from_panel
    tilt = math.degrees(math.acos(max(-1.0, min(1.0, float(base_from_panel.rotation[2, 2])))))
    if tilt > config.max_tilt_deg:
        raise TargetRefused(
            Message("target.panel_leans_degrees_most_allowed", tilt_deg=tilt, max_tilt_deg=config.max_tilt_deg)
        )
    point, control = _surface(gesture.target, scene)
    if control is not None and control.kind in UNTOUCHABLE:
        raise TargetRefused(Message("target.connectors_never_pressed", control=control.name, kind=control.kind))
    if gesture.kind in TURNING:
        if control is None:
            raise TargetRefused(Message("target.only_knob_can_turned_no"))
        if control.kind not in TURNABLE:
            raise TargetRefused(Message("target.only_knob_can_turned", control=control.name, kind=control.kind))
        way = gesture.argument if math.isnan(turn_deg) else turn_deg
        if control.dimple is None:
            contacts = turn_points(control, way, config)
        elif math.isnan(knob_deg):
            raise TargetRefused(Message("target.turned_dimple_found_marker_turn", control=control.name))
        else:
            contacts = dimple_points(control, control.dimple, knob_deg, way, config)
    elif gesture.to is not None:
        contacts = _drag_points(point, control, gesture.to, scene)
    else:
        contacts = point[np.newaxis]
    low, high = scene.panel.extent
    if not ((low <= point[:2]) & (point[:2] <= high)).all():
        raise TargetRefused(
            Message(
                "target.point_lies_outside_panel",
                point=point[0],
                point_2=point[1],
                panel=PANEL,
                low=low[0],
                low_2=low[1],
                high=high[0],
                high_2=high[1],
            )
        )
    for contact in contacts:
        sinks = control is not None and control.kind in SINKING
        lowest = float(contact[2]) - (max(key_travel_m, config.overtravel_m) if sinks else config.overtravel_m)
        _check_sides(contact, lowest, control, scene.panel.controls, config)

    surface = base_from_panel.apply(contacts)
    above = np.array([0.0, 0.0, config.ball_radius_m - config.overtravel_m])
    return Touch(
        control=control.name if control is not None else "",
        in_panel=contacts[0],
        in_base=surface[0],
        hover_z=_hover_z(contacts[0], scene, config, wander_m),
        touch_z=float((surface[0] + above)[2]),
        arc=surface[1:] + above,
        key=control is not None and control.kind in SINKING,
    )


def places_beside(touch: Touch, scene: Scene, config: TouchConfig, *, by_m: float, wander_m: float) -> list[Array]:
    """Return positions where the ball may hover above the panel, ``by_m`` to the side of a touch; the lowest first.

    Each is a centre of the ball (3,) in base_link, at least as high as above the touch.
    """
    low, high = scene.panel.extent
    places = []
    for step in ((-by_m, 0.0), (by_m, 0.0), (0.0, -by_m), (0.0, by_m)):
        base_xy = touch.in_base[:2] + step
        point, _ = _down(base_xy, scene)
        if ((low <= point[:2]) & (point[:2] <= high)).all():
            places.append(np.array([*base_xy, max(touch.hover_z, _hover_z(point, scene, config, wander_m))]))
    return sorted(places, key=lambda place: float(place[2]))


def with_two_positions(touch: Touch, down_m: float) -> Touch:
    """Return the same touch for a stylus that is either retracted or extended by ``down_m`` (m).

    Raises
    ------
    TargetRefused
        If the touch needs a longer stylus.
    """
    if -touch.touch_z > down_m:
        raise TargetRefused(
            Message("target.touch_needs_extension_stylus_reaches", touch_z_m=-touch.touch_z, down_m=down_m)
        )
    arc = touch.arc.copy()
    arc[:, 2] = -down_m
    return dataclasses.replace(touch, hover_z=0.0, touch_z=-down_m, arc=arc)


def turn_points(control: PanelControl, angle_deg: float, config: TouchConfig) -> Array:
    """Return (N, 3) surface points along the arc that turns a knob by ``angle_deg``, counter-clockwise positive.

    The arc is symmetric about the knob's lower side, where a camera below the panel sees the tip best.
    """
    angles = np.radians(-90.0 + angle_deg * (_shares(angle_deg, config) - 0.5))
    radius = config.turn_radius_fraction * float(control.size.min()) / 2
    return _around(control, radius, angles, control.height)


def dimple_points(
    control: PanelControl, dimple: Dimple, knob_deg: float, angle_deg: float, config: TouchConfig
) -> Array:
    """Return (N, 3) points of a dimple's bottom along the arc that turns its knob, counter-clockwise positive.

    The ball goes down in the dimple's middle. Only the marker shows afterwards how far the ball slid towards the wall,
    and how far friction turned the knob.

    Raises
    ------
    TargetRefused
        If the ball does not reach the bottom, or has too much play there for looks to correct.
    """
    ball, depth = config.ball_radius_m, dimple.depth_mm / 1000
    # Radius of the ball at the level of the rim when it touches the bottom.
    wide = ball if depth >= ball else math.sqrt(ball**2 - (ball - depth) ** 2)
    play = dimple.diameter_mm / 2000 - wide
    if play <= 0:
        raise TargetRefused(
            Message(
                "target.dimple_wide_stylus_needs_more",
                control=control.name,
                diameter_mm=dimple.diameter_mm,
                wide_mm=2000 * wide,
            )
        )
    x, y = (value / 1000 for value in dimple.place_mm)
    radius = math.hypot(x, y)
    play_deg = math.degrees(2 * math.asin(min(play / (2 * radius), 1.0)))
    if play_deg > MOST_BIAS_DEG:
        raise TargetRefused(
            Message(
                "target.stylus_degrees_play_dimple_most",
                play_deg=play_deg,
                control=control.name,
                most_bias_deg=MOST_BIAS_DEG,
            )
        )
    angles = math.atan2(y, x) + np.radians(knob_deg + angle_deg * _shares(angle_deg, config))
    return _around(control, radius, angles, control.height - depth)


def _shares(angle_deg: float, config: TouchConfig) -> Array:
    """Return the fraction of a turn at each point of its arc, 0 to 1."""
    steps = max(1, math.ceil(abs(angle_deg) / config.turn_step_deg - 1e-9))
    return np.arange(steps + 1) / steps


def _around(control: PanelControl, radius: float, angles: Array, height: float) -> Array:
    """Return (N, 3) points at angles (N,) rad around a control's middle."""
    xy = control.centre + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return np.column_stack([xy, np.full(len(angles), height)])


def _drag_points(start: Array, control: PanelControl | None, to: Point, scene: Scene) -> Array:
    """Return (N, 3) surface points of a drag, the start first, no farther apart than DRAG_STEP_M."""
    if control is None or control.kind not in DRAGGABLE:
        name = Message("target.bare_face") if control is None else f"{control.name}, a {control.kind}"
        raise TargetRefused(Message("target.drag_begins_only_touch_area", name=name))
    end, other = _surface(to, scene)
    if other is not control:
        name = Message("target.bare_face") if other is None else other.name
        raise TargetRefused(Message("target.drag_begins_ends_must_stay", control=control.name, name=name))
    steps = max(1, math.ceil(float(np.linalg.norm(end - start)) / DRAG_STEP_M))
    share = np.linspace(0.0, 1.0, steps + 1)[:, np.newaxis]
    return np.asarray(start + share * (end - start))


def highest_near(base_xy: npt.ArrayLike, scene: Scene, within_m: float) -> float:
    """Return the base z of the highest control within ``within_m`` of a position (2,), or of the face there."""
    point, _ = _down(np.asarray(base_xy, dtype=np.float64), scene)
    return _highest_z(point, scene, within_m)


def _down(base_xy: Array, scene: Scene) -> tuple[Array, PanelControl | None]:
    panel_from_base = scene.base_from_panel.inverse()
    origin = panel_from_base.apply([*base_xy, 1.0])
    return scene.first_hit(origin, panel_from_base.rotation @ np.array([0.0, 0.0, -1.0]))


def _surface(target: str | Point, scene: Scene) -> tuple[Array, PanelControl | None]:
    if isinstance(target, str):
        control = scene.control(target)
        return np.array([*control.centre, control.height]), control
    if target.frame == BASE:
        return _down(np.array([target.x, target.y]), scene)
    if target.frame == PANEL:
        return scene.first_hit(np.array([target.x, target.y, 1.0]), np.array([0.0, 0.0, -1.0]))
    if target.frame == CAMERA_LEFT:
        width, height = scene.camera.size
        # Pixel centres are whole numbers, so the image extends half a pixel further.
        if not (-0.5 <= target.x <= width - 0.5 and -0.5 <= target.y <= height - 0.5):
            raise TargetRefused(
                Message("target.pixel_lies_outside_picture", x=target.x, y=target.y, width=width, height=height)
            )
        ray = scene.camera.rays([[target.x, target.y]])[0]
        panel_from_camera = scene.camera_from_panel.inverse()
        return scene.first_hit(panel_from_camera.translation, panel_from_camera.rotation @ ray)
    raise TargetRefused(Message("goal.frame_none", frame=quoted(target.frame), frames=", ".join(FRAMES)))


def _check_sides(
    contact: Array, lowest: float, own: PanelControl | None, controls: Sequence[PanelControl], config: TouchConfig
) -> None:
    needed = config.side_needed_m()
    for other in controls:
        proud = other.height > _PROUD_M and other.height > lowest
        if other is own or not proud:
            continue
        gap = other.gap(contact[:2])
        if gap < needed:
            raise TargetRefused(
                Message(
                    "target.point_beside_high_needed",
                    gap_mm=1000 * gap,
                    other=other.name,
                    height_mm=1000 * other.height,
                    needed_mm=1000 * needed,
                )
            )


def _hover_z(contact: Array, scene: Scene, config: TouchConfig, wander_m: float) -> float:
    surface_z = float(scene.base_from_panel.apply(contact)[2])
    tops = _highest_z(contact, scene, wander_m + max(config.ball_radius_m, config.shaft_radius_m))
    return max(surface_z + config.hover_m, tops + config.top_clearance_m) + config.ball_radius_m


def _highest_z(in_panel: Array, scene: Scene, within_m: float) -> float:
    near = [c for c in scene.panel.controls if c.gap(in_panel[:2]) < within_m]
    points = [in_panel, *(np.array([*c.centre, c.height]) for c in near)]
    return float(scene.base_from_panel.apply(np.array(points))[:, 2].max())
