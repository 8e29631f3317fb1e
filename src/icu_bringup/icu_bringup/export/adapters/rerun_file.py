"""A recording for the Rerun viewer: the 3D scene next to the images, and readings and texts below."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.export.adapters.pictures import as_file, pixels
from icu_bringup.export.adapters.reading import cameras, decoded, kinds_of
from icu_bringup.export.core.session import JOINTS, RESULT, TOPICS, TRAJECTORY
from icu_common.core.geometry.geometry import Transform

BASE_POSE, PANEL_POSE = "/calibration/camera_from_base", "/panel/pose"
AXES, CONTROLS, TIP, POINTS = "/calibration/axes", "/panel/controls", "/stylus/tip", "/stereo/points2"
CLOCK = "time"
TEXT, INFO = "std_msgs/msg/String", "sensor_msgs/msg/CameraInfo"
SHOWN = {
    **{topic: TOPICS[topic] for topic in (JOINTS, TRAJECTORY, RESULT)},
    **{f"/stereo/{side}/camera_info": INFO for side in ("left", "right")},
    BASE_POSE: "geometry_msgs/msg/TransformStamped",
    PANEL_POSE: "geometry_msgs/msg/PoseStamped",
    AXES: "std_msgs/msg/Float64MultiArray",
    CONTROLS: "visualization_msgs/msg/MarkerArray",
    TIP: "geometry_msgs/msg/PointStamped",
    POINTS: "sensor_msgs/msg/PointCloud2",
}
"""Displayed topics besides images and texts, and their types."""
AXIS_M, STYLUS_M = 0.05, 0.004
"""Length of the drawn axes of base_link, and radius of the drawn stylus tip."""
EYE, EYE_TARGET = (0.4, -0.62, -0.25), (0.1, 0.05, 0.5)
"""Eye and target of the first view of the scene, in units of the distance from the left camera to the panel."""


class Recording:
    """Writes one .rrd file; 3D is in camera_left_optical_frame, or in base_link if no calibration is recorded."""

    def __init__(self, path: Path, bag: BagReader, namespace: str = "") -> None:
        import rerun as rr
        import rerun.blueprint as rrb

        self._rr, self._bag, self._namespace = rr, bag, namespace
        self._kinds, self._cameras = kinds_of(bag), cameras(bag, namespace)
        calibrated = namespace + BASE_POSE in self._kinds
        self._base = "scene/base" if calibrated else "base"
        self._axes = np.eye(2)
        self._trace: list[list[float]] = []
        self._stream = rr.RecordingStream("icu_gantry")
        views = [rrb.Spatial2DView(origin=f"images/{name}", name=name) for name in self._cameras.values()]
        seen = calibrated or namespace + PANEL_POSE in self._kinds
        scene = rrb.Spatial3DView(
            origin="scene" if seen else "base", eye_controls=rrb.EyeControls3D(**self._eye()) if seen else None
        )
        below = rrb.Horizontal(rrb.TimeSeriesView(origin="joints"), rrb.TextLogView(origin="texts"))
        layout = rrb.Vertical(rrb.Horizontal(scene, rrb.Vertical(*views)), below, row_shares=[3, 1])
        self._stream.save(path, default_blueprint=rrb.Blueprint(layout))
        if seen:
            self._stream.log("scene", rr.ViewCoordinates.RDF, static=True)
        self.problems: dict[str, list[str]] = {}

    def write(self) -> int:
        """Log every message that the recording can show; return their number."""
        count, expected = 0, {self._namespace + topic: kind for topic, kind in SHOWN.items()}
        shown = {topic for topic, kind in self._kinds.items() if kind in (TEXT, expected.get(topic))}
        self._log_first_calibration()
        for topic, received_ns, message in decoded(self._bag, shown | set(self._cameras)):
            self._set_time(received_ns)
            try:
                self._take(topic, topic.removeprefix(self._namespace), message)
            except (ValueError, cv2.error) as error:
                self.problems.setdefault(topic, []).append(str(error))
                continue
            count += 1
        self._log_stage()
        self._stream.flush()
        self._stream.disconnect()
        return count

    def _eye(self) -> dict[str, list[float]]:
        """Return a first view from above and behind the cameras; the viewer's default may leave a camera out."""
        distance_m = 0.6
        for topic in (BASE_POSE, PANEL_POSE):
            if self._kinds.get(self._namespace + topic) == SHOWN[topic]:
                _, _, message = next(decoded(self._bag, {self._namespace + topic}))
                distance_m = float((message.transform.translation if topic == BASE_POSE else message.pose.position).z)
        position, target = (distance_m * np.array(part) for part in (EYE, EYE_TARGET))
        return {"position": position.tolist(), "look_target": target.tolist(), "eye_up": [0.0, -1.0, 0.0]}

    def _set_time(self, time_ns: int) -> None:
        self._stream.set_time(CLOCK, timestamp=np.datetime64(time_ns, "ns"))

    def _log_first_calibration(self) -> None:
        """Log the first calibration at the start of the bag, for the readings before it.

        The viewer puts an entity without a transform at the scene's origin: the stage would start in the left camera.
        """
        self._set_time(self._bag.start_ns)
        for topic in (AXES, BASE_POSE):
            name = self._namespace + topic
            if self._kinds.get(name) != SHOWN[topic]:
                continue
            _, received_ns, message = next(decoded(self._bag, {name}))
            if received_ns > self._bag.start_ns:
                with contextlib.suppress(ValueError):  # write() reports it at the message's own time
                    self._take(name, topic, message)

    def _take(self, name: str, topic: str, message: Any) -> None:
        rr, log = self._rr, self._stream.log
        if name in self._cameras:
            log(f"images/{self._cameras[name]}", self._image(message))
        elif topic == JOINTS:
            self._log_joints(dict(zip(message.name, message.position)))
        elif topic == TRAJECTORY:
            path = [self._tip(dict(zip(message.joint_names, p.positions))) for p in message.points]
            log(f"{self._base}/path", rr.LineStrips3D([path]))
        elif topic in (BASE_POSE, PANEL_POSE):
            pose = _transform(message.transform) if topic == BASE_POSE else _transform(message.pose)
            entity = self._base if topic == BASE_POSE else "scene/panel"
            log(entity, rr.Transform3D(translation=pose.translation, mat3x3=pose.rotation))
        elif topic == AXES:
            self._axes = np.array(message.data).reshape(2, 2) if len(message.data) == 4 else np.eye(2)
        elif topic == CONTROLS:
            places = [m.pose.position for m in message.markers]
            sizes = [[m.scale.x / 2, m.scale.y / 2, m.scale.z / 2] for m in message.markers]
            boxes = rr.Boxes3D(
                centers=[[p.x, p.y, p.z] for p in places],
                half_sizes=sizes,
                labels=[m.text for m in message.markers],
                show_labels=False,  # they cover the panel; the viewer shows the one under the pointer
            )
            log("scene/panel/controls", boxes)
        elif topic == TIP:
            log("scene/tip", rr.Points3D([[message.point.x, message.point.y, message.point.z]], radii=0.002))
        elif topic == POINTS:
            log("scene/points", rr.Points3D(_cloud(message), radii=0.0005))
        elif topic.endswith("/camera_info"):
            p = np.array(message.p).reshape(3, 4)
            side = topic.split("/")[2]
            if p[0, 0]:
                log(f"scene/{side}", rr.Transform3D(translation=[-p[0, 3] / p[0, 0], 0, 0]))
                log(f"scene/{side}", rr.Pinhole(image_from_camera=p[:, :3], width=message.width, height=message.height))
        elif topic == RESULT:
            for status in message.status:
                goal = next((pair.value for pair in status.values if pair.key == "goal"), "")
                log(f"texts{topic}", rr.TextLog(f"{goal}: {status.message}"))
        else:
            log(f"texts{topic}", rr.TextLog(message.data))

    def _image(self, message: Any) -> Any:
        if not hasattr(message, "encoding"):
            suffix, data = as_file(message)
            return self._rr.EncodedImage(contents=data, media_type="image/jpeg" if suffix == "jpg" else "image/png")
        picture = pixels(message)
        model = "L" if picture.ndim == 2 else ("BGR" if picture.shape[2] == 3 else "BGRA")
        return self._rr.Image(picture, color_model=model)

    def _log_joints(self, position: dict[str, float]) -> None:
        for joint, metres in position.items():
            self._stream.log(f"joints/{joint}", self._rr.Scalars(float(metres)))
        self._trace.append(self._tip(position))
        self._stream.log(
            f"{self._base}/stylus",
            self._rr.Points3D([self._trace[-1]], radii=STYLUS_M, colors=[255, 0, 160], labels=["stylus"]),
        )

    def _log_stage(self) -> None:
        """Log the axes of base_link and all positions of the stylus, which the scene shows at every time."""
        if not self._trace:
            return
        axes = self._rr.Arrows3D(vectors=AXIS_M * np.eye(3), colors=255 * np.eye(3, dtype=np.uint8), labels=list("xyz"))
        self._stream.log(f"{self._base}/axes", axes, static=True)
        trace = self._rr.LineStrips3D([self._trace], colors=[128, 128, 128])
        self._stream.log(f"{self._base}/trace", trace, static=True)

    def _tip(self, position: dict[str, float]) -> list[float]:
        try:
            readings = [position["gantry_x_joint"], position["gantry_y_joint"]]
            return [*(self._axes @ readings).tolist(), -float(position["stylus_joint"])]
        except KeyError as error:
            raise ValueError(f"joint {error} is missing") from error


def _transform(value: Any) -> Transform:
    place, q = (
        getattr(value, "translation", None) or value.position,
        getattr(value, "rotation", None) or value.orientation,
    )
    return Transform.from_quaternion((q.x, q.y, q.z, q.w), (place.x, place.y, place.z))


def _cloud(message: Any) -> np.ndarray:
    offsets = {f.name: f.offset for f in message.fields if f.datatype == 7}
    if not {"x", "y", "z"} <= set(offsets):
        raise ValueError("the cloud has no float32 fields x, y, z")
    kind = np.dtype({"names": list("xyz"), "formats": ["<f4"] * 3, "offsets": [offsets[n] for n in "xyz"],
                     "itemsize": message.point_step})  # fmt: skip
    rows = np.frombuffer(np.asarray(message.data, np.uint8).tobytes(), kind, message.width * message.height)
    points = np.stack([rows[name] for name in "xyz"], axis=1)
    finite: np.ndarray = points[np.isfinite(points).all(axis=1)]
    return finite
