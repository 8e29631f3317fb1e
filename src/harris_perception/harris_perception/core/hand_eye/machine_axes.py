"""Rotation, scale and skew of the machine's axes, and rejection of implausible axes and stylus directions."""

from __future__ import annotations

import numpy as np

from harris_perception.core.hand_eye.degeneracy import DegenerateError
from harris_perception.core.hand_eye.hand_eye_config import HandEyeConfig
from icu_common.core.geometry.geometry import Array, nearest_rotation
from icu_common.core.reasons.message import Message


def split_axes(x_rail: Array, y_rail: Array, config: HandEyeConfig) -> tuple[Array, Array]:
    """Return R (3, 3) and upper triangular M (2, 2) with [x_rail, y_rail] = R[:, :2] M.

    Raises
    ------
    DegenerateError
        If the axes are implausible.
    """
    x = x_rail / np.linalg.norm(x_rail)
    z = np.cross(x_rail, y_rail)
    z /= np.linalg.norm(z)
    y = np.cross(z, x)
    rotation = nearest_rotation(np.column_stack([x, y, z]))
    axes = np.array([[np.linalg.norm(x_rail), x @ y_rail], [0.0, y @ y_rail]])
    check_axes(axes, config)
    return rotation, axes


def axes_skew(base_from_reading: Array) -> float:
    """Return the deviation of the axes from 90 degrees, rad; positive if y leans towards x."""
    return float(np.arctan2(base_from_reading[0, 1], base_from_reading[1, 1]))


def check_axes(axes: Array, config: HandEyeConfig) -> None:
    """Reject an implausible base_from_reading (2, 2).

    Raises
    ------
    DegenerateError
        With the axis and the plausible range.
    """
    skew = axes_skew(axes)
    for name, scale in (("x", axes[0, 0]), ("y", axes[1, 1])):
        if abs(scale - 1) > config.max_scale_error:
            raise DegenerateError(
                Message(
                    "axes.axis_moves_per_metre_reading",
                    name=name,
                    scale_m=scale,
                    max_scale_error=1 - config.max_scale_error,
                    max_scale_error_2=1 + config.max_scale_error,
                )
            )
    if abs(skew) > config.max_skew:
        raise DegenerateError(
            Message(
                "axes.axes_miss_right_angle_degrees", degrees_deg=np.degrees(skew), degrees=np.degrees(config.max_skew)
            )
        )


def check_side(camera_from_axes: Array, seen: Array) -> None:
    """Reject axes (3, 3) that are mirrored; without a fitted stylus no other check detects this.

    Their z is computed from x and y, and points out of the panel, towards the cameras, which see its face at ``seen``
    (3,) m.

    Raises
    ------
    DegenerateError
        With the parts that may be reversed.
    """
    if not camera_from_axes[:, 2] @ seen < 0:
        raise DegenerateError(Message("axes.not_go_they_should_one"))


def check_stylus(direction: Array, config: HandEyeConfig) -> None:
    """Reject an implausible motion (3,) in base_link per metre of extension.

    One sample at another extension fits every direction, even if its tip was measured wrongly.

    Raises
    ------
    DegenerateError
        With the deviation and the plausible range.
    """
    depth, aside = -float(direction[2]), float(np.hypot(*direction[:2]))
    if abs(depth + 1) <= config.max_scale_error:
        raise DegenerateError(Message("axes.stylus_not_go_they_should"))
    if not abs(depth - 1) <= config.max_scale_error:
        raise DegenerateError(
            Message(
                "axes.stylus_moves_towards_panel_per",
                depth_m=depth,
                max_scale_error=1 - config.max_scale_error,
                max_scale_error_2=1 + config.max_scale_error,
            )
        )
    if not np.arctan2(aside, depth) <= config.max_skew:
        raise DegenerateError(
            Message(
                "axes.stylus_leans_degrees_plausible_add",
                degrees_deg=np.degrees(np.arctan2(aside, depth)),
                degrees=np.degrees(config.max_skew),
            )
        )
