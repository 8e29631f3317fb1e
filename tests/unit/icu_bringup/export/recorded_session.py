"""A small session as a bag: goals, a trajectory, two cameras, a calibration, joint positions with a gap."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.typesys import Stores, get_typestore

from icu_bringup.adapters.bag.bag_writer import BagWriter
from icu_bringup.adapters.bag.bags import BagTopic

TYPES = get_typestore(Stores.ROS2_JAZZY)
START_NS = 1_700_000_000_000_000_000
NAMES = ["gantry_x_joint", "gantry_y_joint", "stylus_joint"]
WIDTH, HEIGHT = 64, 48
JOINT_PERIOD_S, GAP = 0.05, (1.0, 1.6)
AXES = ((1.0, 0.5), (0.0, 1.0))
"""Directions of the two rails in base_link, in the columns."""
KINDS = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/gantry/goal": "geometry_msgs/msg/PointStamped",
    "/gantry/command": "std_msgs/msg/String",
    "/gantry/driver_state": "std_msgs/msg/String",
    "/gantry/machine_settings": "std_msgs/msg/String",
    "/gantry/result": "diagnostic_msgs/msg/DiagnosticArray",
    "/gantry/trajectory": "trajectory_msgs/msg/JointTrajectory",
    "/gantry/trajectory_result": "diagnostic_msgs/msg/DiagnosticArray",
    "/stereo/left/image_raw/compressed": "sensor_msgs/msg/CompressedImage",
    "/stereo/right/image_raw": "sensor_msgs/msg/Image",
    "/stereo/left/camera_info": "sensor_msgs/msg/CameraInfo",
    "/stereo/right/camera_info": "sensor_msgs/msg/CameraInfo",
    "/calibration/axes": "std_msgs/msg/Float64MultiArray",
    "/calibration/camera_from_base": "geometry_msgs/msg/TransformStamped",
    "/panel/pose": "geometry_msgs/msg/PoseStamped",
    "/stylus/tip": "geometry_msgs/msg/PointStamped",
}


def make(kind: str, /, **fields: Any) -> Any:
    return TYPES.types[kind](**fields)


def stamp(seconds: float) -> Any:
    sec, nanosec = divmod(START_NS + round(seconds * 1e9), 10**9)
    return make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)


def header(seconds: float, frame: str = "") -> Any:
    return make("std_msgs/msg/Header", stamp=stamp(seconds), frame_id=frame)


def text(data: str) -> Any:
    return make("std_msgs/msg/String", data=data)


def answer(seconds: float, goal_id: str, outcome: str, **more: str) -> Any:
    pairs = {"goal_id": goal_id, "goal": goal_id, "outcome": outcome, "error_m": "nan", "duration_s": "nan", **more}
    values = [make("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in pairs.items()]
    status = make(
        "diagnostic_msgs/msg/DiagnosticStatus", level=0, name="goal", message=outcome, hardware_id="", values=values
    )
    return make("diagnostic_msgs/msg/DiagnosticArray", header=header(seconds), status=[status])


def joints(seconds: float) -> Any:
    """Return positions in metres that differ at each time."""
    position = np.array([0.01 * seconds, 0.02 * seconds, 0.001 * seconds])
    empty = np.array([])
    return make(
        KINDS["/joint_states"], header=header(seconds), name=NAMES, position=position, velocity=empty, effort=empty
    )


def picture(number: int, side: str) -> np.ndarray:
    """Return a BGR picture with a slope and a square that moves; no noise, so that JPEG keeps it."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    image = np.stack([columns * 2, rows * 3, np.full_like(rows, 40 if side == "left" else 90)], axis=2).astype(np.uint8)
    image[8:24, number % 40 : number % 40 + 16] = (200, 60, 30)
    return image


def rows() -> list[tuple[str, float, Any]]:
    """Return (topic, seconds after the start, message)."""
    found: list[tuple[str, float, Any]] = [
        ("/gantry/machine_settings", 0.0, text("$100=80.000")),
        ("/gantry/driver_state", 0.0, text("idle")),
    ]
    half = 0.5**0.5
    turn = make("geometry_msgs/msg/Quaternion", x=half, y=0.0, z=0.0, w=half)
    shift = make("geometry_msgs/msg/Vector3", x=0.1, y=0.2, z=0.5)
    place = make("geometry_msgs/msg/Point", x=0.1, y=0.2, z=0.6)
    transform = make("geometry_msgs/msg/Transform", translation=shift, rotation=turn)
    pose = make("geometry_msgs/msg/Pose", position=place, orientation=turn)
    left = header(0.0, "camera_left_optical_frame")
    base, axes = "/calibration/camera_from_base", "/calibration/axes"
    shape = make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    found += [
        (axes, 0.0, make(KINDS[axes], layout=shape, data=np.array(AXES).ravel())),
        (base, 0.0, make(KINDS[base], header=left, child_frame_id="base_link", transform=transform)),
        ("/panel/pose", 0.0, make(KINDS["/panel/pose"], header=left, pose=pose)),
        ("/stylus/tip", 0.3, make(KINDS["/stylus/tip"], header=left, point=place)),
    ]
    found += [
        ("/joint_states", i * JOINT_PERIOD_S, joints(i * JOINT_PERIOD_S))
        for i in range(81)
        if not GAP[0] < i * JOINT_PERIOD_S < GAP[1] - 1e-9
    ]
    for i in range(20):
        seconds = 0.1 + 0.2 * i
        done, packed = cv2.imencode(".jpg", picture(i, "left"), [cv2.IMWRITE_JPEG_QUALITY, 95])
        assert done
        left = make(
            KINDS["/stereo/left/image_raw/compressed"],
            header=header(seconds, "camera_left_optical_frame"),
            format="bgr8; jpeg compressed bgr8",
            data=packed.ravel(),
        )
        right = make(
            KINDS["/stereo/right/image_raw"],
            header=header(seconds, "camera_right_optical_frame"),
            height=HEIGHT,
            width=WIDTH,
            encoding="rgb8",
            is_bigendian=0,
            step=3 * WIDTH,
            data=np.ascontiguousarray(picture(i, "right")[:, :, ::-1]).ravel(),
        )
        found += [("/stereo/left/image_raw/compressed", seconds, left), ("/stereo/right/image_raw", seconds, right)]
        found += [(f"/stereo/{side}/camera_info", seconds, info(seconds, side)) for side in ("left", "right")]
    duration = make("builtin_interfaces/msg/Duration", sec=1, nanosec=0)
    nothing = np.array([])
    point = make(
        "trajectory_msgs/msg/JointTrajectoryPoint",
        positions=np.array([0.11, 0.22, 0.0]),
        velocities=nothing,
        accelerations=nothing,
        effort=nothing,
        time_from_start=duration,
    )
    goal = make("geometry_msgs/msg/Point", x=0.11, y=0.22, z=0.0)
    goal_id, motion = str(START_NS + 400_000_000), str(START_NS + 500_000_000)
    found += [
        ("/gantry/goal", 0.41, make(KINDS["/gantry/goal"], header=header(0.4, "base_link"), point=goal)),
        ("/gantry/result", 0.5, answer(0.5, goal_id, "accepted")),
        (
            "/gantry/trajectory",
            0.5,
            make(KINDS["/gantry/trajectory"], header=header(0.5), joint_names=NAMES, points=[point]),
        ),
        ("/gantry/trajectory_result", 0.51, answer(0.51, motion, "accepted")),
        ("/gantry/result", 1.9, answer(1.9, goal_id, "reached", error_m="0.00021", duration_s="1.4")),
        ("/gantry/command", 2.0, text("press:RUN_STOP id=a1")),
        ("/gantry/result", 2.1, answer(2.1, "a1", "accepted")),
        ("/gantry/result", 3.1, answer(3.1, "a1", "aborted", reason="stopped", duration_s="1.0")),
        ("/gantry/command", 3.3, text("press:MENU id=a2")),
        ("/gantry/result", 3.31, answer(3.31, "a2", "rejected", reason="not enabled")),
    ]
    return sorted(found, key=lambda row: row[1])


def info(seconds: float, side: str) -> Any:
    shift = 0.0 if side == "left" else -6.0
    region = make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    return make(
        "sensor_msgs/msg/CameraInfo",
        header=header(seconds, f"camera_{side}_optical_frame"),
        height=HEIGHT,
        width=WIDTH,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=np.array([50.0, 0, 32, 0, 50, 24, 0, 0, 1]),
        r=np.eye(3).ravel(),
        p=np.array([50.0, 0, 32, shift, 0, 50, 24, 0, 0, 0, 1, 0]),
        binning_x=0,
        binning_y=0,
        roi=region,
    )


def write(path: Path, *, namespace: str = "", without: tuple[str, ...] = (), calibrated_s: float = 0.0) -> Path:
    """Write the bag, without some topics; the calibration ends ``calibrated_s`` after the start."""
    late = {"/calibration/axes", "/calibration/camera_from_base"}
    found = [(name, calibrated_s if name in late else seconds, message) for name, seconds, message in rows()]
    with BagWriter(path, "mcap") as bag:
        for name, kind in KINDS.items():
            if name not in without:
                bag.add_topic(BagTopic(name=namespace + name, type=kind))
        for name, seconds, message in sorted(found, key=lambda row: row[1]):
            if name not in without:
                data = bytes(TYPES.serialize_cdr(message, KINDS[name]))
                bag.write(namespace + name, START_NS + round(seconds * 1e9), data)
    return path
