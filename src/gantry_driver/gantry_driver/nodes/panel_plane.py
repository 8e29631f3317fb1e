"""The topic ``panel/plane``: the panel's plane as a pose with its covariance, in readings.

The pose's position is a point on the plane, and its z axis is the plane's normal. x and y are the readings of the axes,
z is minus the extension. Only the covariance of the shift along z and of the rotations about x and y counts.
"""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped

from gantry_driver.core.envelope.plane import PanelPlane
from icu_common.core.geometry.frames import READINGS
from icu_common.core.geometry.geometry import Array, Transform
from icu_common.nodes.messages.heads import check_frame, header
from icu_common.nodes.messages.places import covariance_array, estimate_message, transform_of_pose

_SHIFT_AND_TURNS = np.ix_([2, 3, 4], [2, 3, 4])
_SLOPES_OF_TURNS = np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""Matrix from a shift along z and rotations about x and y to the extension and its slopes along x and y."""


def plane_message(plane: PanelPlane, stamp_ns: int) -> PoseWithCovarianceStamped:
    """Pack a plane."""
    x, y, extension = plane.at_m
    normal = np.array([*plane.slope, 1.0])
    covariance = np.zeros((6, 6))
    own = np.array(plane.covariance).reshape(3, 3)
    covariance[_SHIFT_AND_TURNS] = _SLOPES_OF_TURNS.T @ own @ _SLOPES_OF_TURNS
    pose = Transform(_rotation_to(normal / np.linalg.norm(normal)), np.array([x, y, -extension]))
    return estimate_message(pose, covariance, header(stamp_ns, READINGS))


def plane_of_message(message: PoseWithCovarianceStamped) -> PanelPlane:
    """Unpack a plane; raise ValueError if no panel can have it."""
    check_frame(message.header, READINGS)
    pose = transform_of_pose(message.pose.pose)
    normal, (x, y, z) = pose.rotation[:, 2], (float(value) for value in pose.translation)
    if not normal[2] > 0.0:
        raise ValueError("the panel's plane faces away from the stylus")
    own = _SLOPES_OF_TURNS @ covariance_array(message)[_SHIFT_AND_TURNS] @ _SLOPES_OF_TURNS.T
    return PanelPlane(
        at_m=(x, y, -z),
        slope=(float(normal[0] / normal[2]), float(normal[1] / normal[2])),
        covariance=tuple(own.ravel().tolist()),
    )


def _rotation_to(normal: Array) -> Array:
    """Return the shortest rotation (3, 3) of the z axis to a unit vector (3,) above the plane of x and y."""
    x, y, z = normal
    share = 1.0 / (1.0 + z)
    return np.array([[1.0 - share * x * x, -share * x * y, x], [-share * x * y, 1.0 - share * y * y, y], [-x, -y, z]])
