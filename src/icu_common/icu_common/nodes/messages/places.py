"""Points, poses and transforms as messages, and back."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import (
    Point,
    PointStamped,
    Pose,
    PoseStamped,
    PoseWithCovarianceStamped,
    Quaternion,
    TransformStamped,
    Vector3,
)
from std_msgs.msg import Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout

from icu_common.core.geometry.geometry import Array, Transform


def point_message(xyz: npt.ArrayLike, head: Header) -> PointStamped:
    """Pack (3,) metres."""
    x, y, z = (float(v) for v in np.asarray(xyz, dtype=np.float64))
    return PointStamped(header=head, point=Point(x=x, y=y, z=z))


def point_array(message: PointStamped) -> Array:
    """Return (3,) metres."""
    return np.array([message.point.x, message.point.y, message.point.z])


def pose(transform: Transform) -> Pose:
    """Pack a transform as a Pose."""
    x, y, z = (float(v) for v in transform.translation)
    qx, qy, qz, qw = (float(v) for v in transform.quaternion())
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def transform_of_pose(value: Pose) -> Transform:
    """Unpack a Pose."""
    q, t = value.orientation, value.position
    return Transform.from_quaternion((q.x, q.y, q.z, q.w), (t.x, t.y, t.z))


def pose_message(frame_from_object: Transform, head: Header) -> PoseStamped:
    """Pack the pose of an object in the header's frame."""
    return PoseStamped(header=head, pose=pose(frame_from_object))


def estimate_message(frame_from_object: Transform, covariance: Array, head: Header) -> PoseWithCovarianceStamped:
    """Pack a pose with its covariance (6, 6): shift [m], then rotation [rad], along and about the frame's axes."""
    message = PoseWithCovarianceStamped(header=head)
    message.pose.pose = pose(frame_from_object)
    message.pose.covariance = np.asarray(covariance, dtype=np.float64).ravel()
    return message


def covariance_array(message: PoseWithCovarianceStamped) -> Array:
    """Unpack the covariance (6, 6) of :func:`estimate_message`.

    Raises
    ------
    ValueError
        If a value is not finite or a variance is below zero.
    """
    covariance = np.array(message.pose.covariance, dtype=np.float64).reshape(6, 6)
    if not np.isfinite(covariance).all() or np.diag(covariance).min() < 0:
        raise ValueError(f"a covariance must be finite with no variance below zero, not {np.diag(covariance).tolist()}")
    return covariance


def transform_message(parent_from_child: Transform, head: Header, child: str) -> TransformStamped:
    """Pack parent_from_child; the parent is the header's frame."""
    value = pose(parent_from_child)
    message = TransformStamped(header=head, child_frame_id=child)
    message.transform.translation = Vector3(x=value.position.x, y=value.position.y, z=value.position.z)
    message.transform.rotation = value.orientation
    return message


def transform_of_message(message: TransformStamped) -> Transform:
    """Unpack parent_from_child."""
    q, t = message.transform.rotation, message.transform.translation
    return Transform.from_quaternion((q.x, q.y, q.z, q.w), (t.x, t.y, t.z))


def axes_message(base_from_reading: Array | None) -> Float64MultiArray:
    """Pack a matrix (2, 2), row by row; a message without values means that the calibration was withdrawn."""
    if base_from_reading is None:
        return Float64MultiArray()
    sizes = [MultiArrayDimension(label=label, size=2, stride=stride) for label, stride in (("base", 4), ("axis", 2))]
    return Float64MultiArray(layout=MultiArrayLayout(dim=sizes), data=base_from_reading.ravel().tolist())


def axes_of_message(message: Float64MultiArray) -> Array | None:
    """Return base_from_reading (2, 2), None if it was withdrawn; raise ValueError unless there are 4 finite values."""
    if len(message.data) not in (0, 4) or not np.isfinite(message.data).all():
        raise ValueError(f"{list(message.data[:5])}; expected 4 finite values (2 x 2, row by row)")
    return np.array(message.data).reshape(2, 2) if message.data else None
