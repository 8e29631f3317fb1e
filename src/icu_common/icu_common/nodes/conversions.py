"""The only place where messages are packed and unpacked; everything else works on numpy arrays and dataclasses."""

from __future__ import annotations

import array
import itertools
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
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
from rclpy.clock import ROSClock
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2, PointField, RegionOfInterest
from std_msgs.msg import ColorRGBA, Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout
from stereo_msgs.msg import DisparityImage
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from icu_common.core.camera_model import CameraModel
from icu_common.core.geometry import Array, Transform
from icu_common.core.panel_layout import Control, Dimple, PanelLayout, rgb
from icu_common.core.panel_state import HIDDEN_BY, ControlSeen, PanelSeen
from icu_common.core.results import GoalResult, Outcome
from icu_common.core.text_bounds import plain
from icu_common.nodes.images import AnyImage

_CHANNELS: dict[str, tuple[Any, int]] = {
    "mono8": (np.uint8, 1),
    "bgr8": (np.uint8, 3),
    "rgb8": (np.uint8, 3),
}
_CHANNELS |= {"bgra8": (np.uint8, 4), "rgba8": (np.uint8, 4)}
_CHANNELS |= {f"bayer_{p}8": (np.uint8, 1) for p in ("rggb", "bggr", "gbrg", "grbg")}
_CHANNELS |= {f"{name[:-1]}16": (np.uint16, count) for name, (_, count) in _CHANNELS.items() if name[-1] == "8"}
_CHANNELS |= {"8UC1": (np.uint8, 1), "16UC1": (np.uint16, 1), "32FC1": (np.float32, 1)}

MOST_AHEAD_S = 0.1
"""So far the clocks of machines may differ: docs/decisions/several-machines.md."""
MAX_PAIRS, MAX_CONTROLS, MAX_NAME = 100, 400, 80
"""Maximum numbers of values in a status, of controls of a panel, and of characters in a name."""
LEVELS = {"ok": DiagnosticStatus.OK, "warn": DiagnosticStatus.WARN, "error": DiagnosticStatus.ERROR}


def time_message(stamp_ns: int) -> Time:
    """Return a Time of ``stamp_ns`` nanoseconds of ROS time."""
    return Time(sec=stamp_ns // 1_000_000_000, nanosec=stamp_ns % 1_000_000_000)


def stamp_ns(time: Time) -> int:
    """Return nanoseconds of ROS time."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def header(stamp: int, frame: str) -> Header:
    """Return a Header with ``stamp`` in nanoseconds."""
    return Header(stamp=time_message(stamp), frame_id=frame)


def check_frame(head: Header, frame: str) -> None:
    """Raise ValueError unless a header names this frame."""
    if head.frame_id != frame:
        raise ValueError(f"frame {plain(head.frame_id)!r}, {frame!r} is needed")


def check_not_ahead(head: Header, clock: ROSClock) -> None:
    """Raise ValueError if the stamp of what was seen is of the future: how old it is cannot be known.

    A recording's clock ticks, and is behind the recording's own stamps by nature.
    """
    ahead_s = (stamp_ns(head.stamp) - int(clock.now().nanoseconds)) / 1e9
    if ahead_s > MOST_AHEAD_S and not clock.ros_time_is_active:
        raise ValueError(f"its stamp is {ahead_s:.3f} s ahead of the clock here, {MOST_AHEAD_S:g} s are allowed")


def _data(values: npt.NDArray[Any]) -> array.array[int]:
    """Return the bytes of a contiguous array as messages take them fastest; see docs/decisions/transport.md."""
    data = array.array("B")
    data.frombytes(values.data.cast("B") if values.size else b"")
    return data


def _float_fields(names: Sequence[str]) -> list[PointField]:
    return [PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1) for i, name in enumerate(names)]


def image_message(picture: npt.NDArray[Any], encoding: str, head: Header) -> Image:
    """Pack (H, W) or (H, W, C)."""
    contiguous = np.ascontiguousarray(picture, picture.dtype.newbyteorder("<"))
    message = Image(header=head, height=contiguous.shape[0], width=contiguous.shape[1], encoding=encoding)
    message.step = int(np.prod(contiguous.shape[1:])) * contiguous.itemsize  # strides of empty arrays are anything
    message.data = _data(contiguous)
    return message


def image_array(message: AnyImage) -> npt.NDArray[Any]:
    """Return a view on the message's pixels, (H, W) or (H, W, C), without a copy; do not write into it.

    Raises
    ------
    ValueError
        For an unknown encoding, or a size that does not fit the data.
    """
    if message.encoding not in _CHANNELS:
        raise ValueError(f"encoding {plain(message.encoding, 40)!r} is none of {', '.join(_CHANNELS)}")
    dtype, channels = _CHANNELS[message.encoding]
    row = message.width * channels * np.dtype(dtype).itemsize
    if message.step < row or len(message.data) < message.step * message.height:
        raise ValueError(
            f"{message.width} x {message.height} {message.encoding} with step {message.step} does not fit "
            f"{len(message.data)} bytes"
        )
    rows = np.frombuffer(message.data, np.uint8)[: message.step * message.height].reshape(message.height, message.step)
    picture: npt.NDArray[Any] = rows[:, :row].view(np.dtype(dtype).newbyteorder(">" if message.is_bigendian else "<"))
    return picture if channels == 1 else picture.reshape(message.height, message.width, channels)


def cloud_message(columns: Sequence[str], values: npt.ArrayLike, head: Header) -> PointCloud2:
    """Pack (N, len(columns)) float32 values as an unorganised cloud with these field names."""
    rows = np.ascontiguousarray(np.asarray(values, dtype=np.float32).reshape(-1, len(columns)))
    cloud = PointCloud2(header=head, height=1, width=len(rows), fields=_float_fields(columns))
    cloud.is_dense, cloud.point_step = bool(np.isfinite(rows).all()), 4 * len(columns)
    cloud.row_step = cloud.point_step * len(rows)
    cloud.data = _data(rows)
    return cloud


def cloud_array(cloud: PointCloud2, columns: Sequence[str]) -> npt.NDArray[np.float32]:
    """Return (N, len(columns)) float32 of the named FLOAT32 fields.

    Raises
    ------
    ValueError
        If a field is missing or not FLOAT32, the bytes have another order, or the size does not fit the data.
    """
    offsets = {f.name: f.offset for f in cloud.fields if f.datatype == PointField.FLOAT32}
    missing = [name for name in columns if name not in offsets]
    if missing:
        raise ValueError(f"the cloud has no float32 field {', '.join(missing)}; it has {_shown(offsets)}")
    if cloud.is_bigendian:
        raise ValueError("the cloud has its most significant bytes first, the other order is needed")
    count, used = cloud.width * cloud.height, cloud.width * cloud.point_step
    # Rows may be padded; a single one need not say how long it is.
    row = (cloud.row_step or used) if cloud.height > 1 else used
    end = max((offsets[name] + 4 for name in columns), default=0)
    if cloud.point_step < end or row < used or len(cloud.data) < row * cloud.height:
        raise ValueError(
            f"a cloud of {cloud.width} x {cloud.height} points with step {cloud.point_step}, rows of {row} bytes and "
            f"fields up to byte {end} does not fit {len(cloud.data)} bytes"
        )
    rows = np.frombuffer(cloud.data, np.uint8)[: row * cloud.height].reshape(cloud.height, row)
    raw = rows[:, :used].reshape(count, cloud.point_step)
    parts = [np.ascontiguousarray(raw[:, offsets[n] : offsets[n] + 4]).view("<f4") for n in columns]
    return np.hstack(parts) if parts else np.empty((count, 0), np.float32)


def organised_cloud_message(xyz_m: npt.NDArray[Any], bgr: npt.NDArray[np.uint8], head: Header) -> PointCloud2:
    """Pack (H, W, 3) points in metres with (H, W, 3) colours, one point for each pixel; unknown points are NaN.

    Colour is the field ``rgb`` as the viewers read it: one float32 whose bytes are blue, green, red and zero.
    """
    height, width = xyz_m.shape[:2]
    points = np.zeros((height, width, 4), np.float32)
    colours = points.view(np.uint8).reshape(height, width, 16)
    for i in range(3):  # one by one: numpy copies rows of three values ten times as slowly
        points[:, :, i] = xyz_m[:, :, i]
        colours[:, :, 12 + i] = bgr[:, :, i]
    fields = _float_fields(("x", "y", "z", "rgb"))
    cloud = PointCloud2(header=head, height=height, width=width, fields=fields, point_step=16, row_step=16 * width)
    cloud.is_dense = bool(np.isfinite(points[:, :, 2]).all())
    cloud.data = _data(points)
    return cloud


def disparity_message(
    disparity_px: npt.NDArray[np.float32],
    focal_px: float,
    baseline_m: float,
    searched_px: tuple[float, float],
    delta_px: float,
    head: Header,
    first_column: int = 0,
) -> DisparityImage:
    """Pack (H, W) float32 disparities, NaN where unknown, as stereo_image_proc does: unknown is ``min_disparity - 1``.

    Depth is ``focal_px * baseline_m / disparity``. ``searched_px`` are the least and the largest disparity that could
    be found, ``delta_px`` their step; columns left of ``first_column`` are never known.
    """
    height, width = disparity_px.shape
    least, largest = np.float32(searched_px[0]), np.float32(searched_px[1])  # what the message's fields can hold
    message = DisparityImage(header=head, f=float(focal_px), t=float(baseline_m))
    message.min_disparity, message.max_disparity, message.delta_d = float(least), float(largest), float(delta_px)
    known = np.where(np.isnan(disparity_px), least - np.float32(1), disparity_px)
    message.image = image_message(known.astype(np.float32, copy=False), "32FC1", head)
    message.valid_window = RegionOfInterest(x_offset=first_column, width=width - first_column, height=height)
    return message


def camera_info_message(model: CameraModel, head: Header) -> CameraInfo:
    """Pack a camera model."""
    info = CameraInfo(header=head, width=model.width, height=model.height, distortion_model="plumb_bob")
    info.d = [float(x) for x in model.d]
    info.k, info.r, info.p = model.k.ravel(), model.r.ravel(), model.p.ravel()
    return info


def camera_model(info: CameraInfo, name: str = "camera") -> CameraModel:
    """Unpack a camera model, of the pictures as they come: of the region of interest, after binning.

    Raises
    ------
    ValueError
        If the camera is not calibrated, has another distortion model than plumb_bob, or a region outside its picture.
    """
    if not info.k[0]:
        raise ValueError("the camera is not calibrated (K is 0)")
    if info.distortion_model != "plumb_bob" or len(info.d) != 5:
        model = plain(info.distortion_model, MAX_NAME)
        raise ValueError(f"distortion {model!r} with {len(info.d)} values: plumb_bob with 5 is needed")
    # The message tells the size and the matrices of the whole picture, the region before binning, and 0 is "whole".
    roi, binning = info.roi, (max(info.binning_x, 1), max(info.binning_y, 1))
    width, height = roi.width or info.width, roi.height or info.height
    if roi.x_offset + width > info.width or roi.y_offset + height > info.height:
        raise ValueError(
            f"region of interest {width} x {height} at {roi.x_offset}, {roi.y_offset} px leaves the picture of "
            f"{info.width} x {info.height} px"
        )
    # A binned pixel covers several, and centres are at whole numbers in both.
    scale = np.diag([1 / binning[0], 1 / binning[1], 1.0])
    scale[:2, 2] = [(0.5 - start) / b - 0.5 for start, b in zip((roi.x_offset, roi.y_offset), binning)]
    return CameraModel(
        name=name,
        width=width // binning[0],
        height=height // binning[1],
        k=scale @ np.array(info.k).reshape(3, 3),
        d=np.array(info.d),
        r=np.array(info.r).reshape(3, 3),
        p=scale @ np.array(info.p).reshape(3, 4),
    )


_CAMERA_FIELDS = ("width", "height", "distortion_model", "binning_x", "binning_y", "roi")


def same_camera(known: CameraInfo | None, info: CameraInfo) -> bool:
    """Return whether two messages hold the same calibration; unpacking each anew costs more than comparing them."""
    return (
        known is not None
        and all(getattr(known, name) == getattr(info, name) for name in _CAMERA_FIELDS)
        and all(np.array_equal(getattr(known, name), getattr(info, name)) for name in "dkrp")
    )


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
    """Pack a pose with its covariance (6, 6): shift [m], then turn [rad], along and about the frame's axes."""
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
    """Pack a matrix (2, 2), row by row; a message without values says that the calibration was withdrawn."""
    if base_from_reading is None:
        return Float64MultiArray()
    sizes = [MultiArrayDimension(label=label, size=2, stride=stride) for label, stride in (("base", 4), ("axis", 2))]
    return Float64MultiArray(layout=MultiArrayLayout(dim=sizes), data=base_from_reading.ravel().tolist())


def axes_of_message(message: Float64MultiArray) -> Array | None:
    """Return base_from_reading (2, 2), None when it was withdrawn; raise ValueError for other than 4 finite values."""
    if len(message.data) not in (0, 4) or not np.isfinite(message.data).all():
        raise ValueError(f"{list(message.data[:5])}: 4 finite values are needed (2 x 2, row by row)")
    return np.array(message.data).reshape(2, 2) if message.data else None


def joint_message(names: Sequence[str], positions_m: Iterable[float], head: Header) -> JointState:
    """Pack joint positions in metres."""
    return JointState(header=head, name=list(names), position=[float(p) for p in positions_m])


def _shown(names: Iterable[str]) -> str:
    return plain(", ".join(plain(name, MAX_NAME) for name in itertools.islice(names, MAX_PAIRS)))


def joint_positions(message: JointState, names: Sequence[str]) -> Array:
    """Return the positions (len(names),) in metres in the order of ``names``.

    Raises
    ------
    ValueError
        If a joint is missing or its position is not finite.
    """
    known = dict(zip(message.name, message.position))
    missing = [name for name in names if name not in known]
    if missing:
        raise ValueError(f"joint {', '.join(missing)} is missing; the message has {_shown(known)}")
    for name in names:
        if not math.isfinite(known[name]):
            raise ValueError(f"joint {name} = {known[name]} m is not finite")
    return np.array([known[name] for name in names])


def trajectory_message(
    names: Sequence[str], positions_m: npt.ArrayLike, times_s: npt.ArrayLike, head: Header
) -> JointTrajectory:
    """Pack positions (N, len(names)) in metres with the times (N,) in seconds after the start at which they are due."""
    points = []
    for position, time_s in zip(np.asarray(positions_m, dtype=np.float64), np.asarray(times_s, dtype=np.float64)):
        nanoseconds = round(float(time_s) * 1e9)
        due = Duration(sec=nanoseconds // 1_000_000_000, nanosec=nanoseconds % 1_000_000_000)
        points.append(JointTrajectoryPoint(positions=[float(p) for p in position], time_from_start=due))
    return JointTrajectory(header=head, joint_names=list(names), points=points)


def trajectory_array(message: JointTrajectory, names: Sequence[str]) -> Array:
    """Return the positions (N, len(names)) in metres of a trajectory's points, in the order of ``names``.

    Raises
    ------
    ValueError
        If a joint is missing, or a point does not have one finite position for each joint.
    """
    missing = [name for name in names if name not in message.joint_names]
    if missing:
        raise ValueError(f"joint {', '.join(missing)} is missing; the message has {_shown(message.joint_names)}")
    order = [list(message.joint_names).index(name) for name in names]
    count = len(message.joint_names)
    for number, point in enumerate(message.points):
        if len(point.positions) != count or not np.isfinite(point.positions).all():
            found = list(point.positions[: count + 1])
            raise ValueError(f"point {number}: {found}: {count} finite positions are needed")
    return np.array([point.positions for point in message.points]).reshape(-1, count)[:, order]


def diagnostic_status(name: str, level: str, message: str, values: Iterable[tuple[str, Any]]) -> DiagnosticStatus:
    """Return a status; ``level`` is ok, warn or error."""
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values]
    return DiagnosticStatus(name=name, level=LEVELS[level], message=message, hardware_id="icu_gantry", values=pairs)


def result_message(result: GoalResult, stamp: int) -> DiagnosticArray:
    """Pack a goal's answer: one status, its name ``goal``, its message ``outcome: reason``, the rest as pairs."""
    level = {Outcome.REJECTED: "warn", Outcome.ABORTED: "error"}.get(result.outcome, "ok")
    text = result.outcome.value + (f": {result.reason}" if result.reason else "")
    values = [
        ("goal_id", result.goal_id),
        ("goal", result.goal),
        ("outcome", result.outcome.value),
        ("reason", result.reason),
        ("error_m", repr(result.error_m)),
        ("duration_s", repr(result.duration_s)),
        *((("code", result.code),) if result.code else ()),
        *result.details,
    ]
    return DiagnosticArray(header=header(stamp, ""), status=[diagnostic_status("goal", level, text, values)])


def pairs_of(status: DiagnosticStatus) -> dict[str, str]:
    """Return the first :data:`MAX_PAIRS` values of a status by key, as texts that are safe to show."""
    return {plain(pair.key, MAX_NAME): plain(pair.value) for pair in status.values[:MAX_PAIRS]}


def result_of_message(message: DiagnosticArray) -> GoalResult:
    """Unpack a goal's answer.

    Raises
    ------
    ValueError
        If the message is something else.
    """
    if len(message.status) != 1 or message.status[0].name != "goal":
        raise ValueError("not the answer to a goal")
    values = pairs_of(message.status[0])
    known = ("goal_id", "goal", "outcome", "reason", "error_m", "duration_s", "code")
    return GoalResult(
        goal_id=values.get("goal_id", ""),
        goal=values.get("goal", ""),
        outcome=Outcome(values.get("outcome", "")),
        reason=values.get("reason", ""),
        error_m=float(values.get("error_m", math.nan)),
        duration_s=float(values.get("duration_s", math.nan)),
        details=tuple((k, v) for k, v in values.items() if k not in known),
        code=values.get("code", ""),
    )


_SHAPES = {"rectangle": Marker.CUBE, "circle": Marker.CYLINDER}
_OUTLINE = "outline"


def panel_state_message(seen: PanelSeen, head: Header) -> DiagnosticArray:
    """Pack what is seen of a panel: one status for each control, named after it, with text for people and values."""
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
    """Unpack what is seen of a panel.

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

    One marker per control: ``ns`` its kind, ``text`` its name, ``id`` its number, position the centre of its top face
    and scale (width, height, how far it stands proud), all in metres. ``points`` of a knob with a dimple: the middle of
    its bottom and a point of its rim, from the middle of the knob's top while the marker points up. Last comes the
    outline as a line strip.
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
