"""Replays the golden bag through perception, hand-eye and controller as processes, and measures the results."""

from __future__ import annotations

import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from golden.make_bag import BAG, CONTROLLER, HERE, TIPS, TRACKER
from system.conftest import wait_for

from icu_common.adapters.step_ledger import LEDGER_VARIABLE, ledger_path
from scope_bench.adapters.bags import BagReader

ROOT = HERE.parents[1]
EXPECTED = HERE / "expected.json"
SIDES = ("left", "right")
RECORDED = (
    *(f"/stereo/{side}/corners" for side in SIDES),
    "/stereo/panel_plane",
    "/stylus/tip",
    "/panel/pose",
    "/calibration/camera_from_base",
    "/calibration/axes",
    "/gantry/result",
)
PROCESSES = 8
"""The seven nodes that work on the recording, and the recorder."""
EVERY = 12
"""Of so many pictures one's corners are compared."""
AMONG, EVERY_NTH = 400, 10
"""Compared are the places of every tenth of the strongest corners."""
TOLERANCES = {
    "corners, count": 0.02,
    "corners, places [px]": 0.05,
    "plane, depth [mm]": 0.2,
    "plane, normal [deg]": 0.1,
    "tips, seen": 2,
    "tips, worst [mm]": 0.1,
    "panel, place [mm]": 0.2,
    "panel, rotation [deg]": 0.1,
    "calibration, camera_from_base [mm]": 0.1,
    "calibration, rotation [deg]": 0.03,
    "calibration, axes [1e-3]": 0.3,
    "goal, outcome": "the same",
    "goal, effect": "the same",
    "goal, target [mm]": 0.2,
    "goal, seen error [mm]": 0.1,
}


def program(package: str, name: str) -> str:
    return str(ROOT / "ros2_ws" / "install" / package / "lib" / package / name)


def settings() -> dict[str, float]:
    """Return what the graph of a replay is told, as the maker of the bag was."""
    nodes = (("stylus_tracker", TRACKER), ("gantry_controller", CONTROLLER))
    told = {f"{node}.{key}": value for node, values in nodes for key, value in values.items()}
    return {"hand_eye.still.tips": TIPS, **told}


@dataclass(slots=True)
class Results:
    """What was published during a replay; stamps in ns, lengths in m."""

    corners: dict[str, dict[int, np.ndarray]] = field(default_factory=lambda: {side: {} for side in SIDES})
    planes: dict[int, np.ndarray] = field(default_factory=dict)
    tips: dict[int, np.ndarray] = field(default_factory=dict)
    panel: np.ndarray = field(default_factory=lambda: np.full(7, np.nan))
    camera: np.ndarray = field(default_factory=lambda: np.full(7, np.nan))
    axes: np.ndarray = field(default_factory=lambda: np.full(4, np.nan))
    goals: list[dict[str, str]] = field(default_factory=list)


def read(path: Path) -> Results:
    """Return what a recording of a replay holds."""
    found = Results()
    with BagReader(path) as bag:
        types = {topic.name: topic.type for topic in bag.topics}
        for topic, _, data in bag.messages():
            message: Any = bag.decode(data, types[topic])
            if topic.endswith("corners"):
                rows = np.frombuffer(bytes(message.data), np.float32).reshape(-1, message.point_step // 4)
                found.corners[topic.split("/")[2]][_stamp(message)] = rows
            elif topic == "/stereo/panel_plane":
                found.planes[_stamp(message)] = _pose(message.pose.position, message.pose.orientation)
            elif topic == "/stylus/tip":
                found.tips[_stamp(message)] = np.array([message.point.x, message.point.y, message.point.z])
            elif topic == "/panel/pose":
                found.panel = _pose(message.pose.position, message.pose.orientation)
            elif topic == "/calibration/camera_from_base":
                found.camera = _pose(message.transform.translation, message.transform.rotation)
            elif topic == "/calibration/axes":
                found.axes = np.array(message.data) if len(message.data) == 4 else np.full(4, np.nan)
            else:
                values = {pair.key: pair.value for pair in message.status[0].values}
                if values["outcome"] != "accepted":
                    found.goals.append(values)
    return found


def _stamp(message: Any) -> int:
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def _pose(place: Any, turn: Any) -> np.ndarray:
    return np.array([place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w])


class ReplayGraph:
    """The graph of the profile ``replay``, in step with its player."""

    def __init__(self, folder: Path, domain: int) -> None:
        self.folder = folder
        self.environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "ROS_LOG_DIR": str(folder / "ros_log"),
            "PYTHONUNBUFFERED": "1",
        }
        command = [program("scope_bench", "bring_up"), "--profile", "replay", "--in-step", "--without", "sequencer"]
        command += ["--state", str(folder / "state"), "--run-dir", str(folder / "run"), "--verbose"]
        command += [part for key, value in settings().items() for part in ("--set", f"{key}={value}")]
        self._log = folder / "bring_up.log"
        with self._log.open("wb") as log:
            self.process = subprocess.Popen(command, env=self.environment, stdout=log, stderr=subprocess.STDOUT)
        self._count = 0

    def play(self, *, rate: float = 1000.0, duration_s: float | None = None, bag: Path = BAG) -> Results:
        """Play the bag, or its beginning, and return what the graph has made of it."""
        self._count += 1
        out = self.folder / f"results_{self._count}"
        recording = self.folder / f"recording_{self._count}.log"
        with recording.open("wb") as log:
            recorder = subprocess.Popen(
                [program("scope_bench", "bag_record"), *RECORDED, "-o", str(out)],
                env={**self.environment, LEDGER_VARIABLE: str(ledger_path(self.environment["ROS_DOMAIN_ID"], ""))},
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        try:
            # A player in step counts for whoever listens when it begins.
            wait_for(lambda: b"recording to" in recording.read_bytes(), 60.0, "the recorder does not begin")
            command = [program("scope_bench", "bag_play"), str(bag), "--in-step", str(PROCESSES), "--moving"]
            command += ["--rate", f"{rate:g}"]
            left_out = ["/gantry/trajectory"]
            if duration_s is not None:
                command += ["--duration", f"{duration_s:g}"]
                left_out += ["/bag/cue"]  # a part is no calibration
            command += ["--exclude", *left_out]
            done = subprocess.run(
                command, env=self.environment, capture_output=True, text=True, timeout=240, check=False
            )
        finally:
            recorder.send_signal(signal.SIGINT)
            recorder.wait(60.0)
        assert done.returncode == 0, f"{done.stdout[-2000:]}\n{done.stderr}\n{self.tail()}"
        return read(out)

    def set_parameter(self, node: str, name: str, value: float) -> None:
        """Set a live parameter of a node of the graph."""
        script = (
            "import sys, rclpy\nfrom rclpy.parameter import Parameter\n"
            "from rclpy.parameter_client import AsyncParameterClient\n"
            "rclpy.init()\nnode = rclpy.create_node('setter')\nclient = AsyncParameterClient(node, sys.argv[1])\n"
            "assert client.wait_for_services(60)\n"
            "for _ in range(3):  # an answer is lost when the node does not know yet where it is awaited\n"
            "    future = client.set_parameters([Parameter(sys.argv[2], value=float(sys.argv[3]))])\n"
            "    rclpy.spin_until_future_complete(node, future, timeout_sec=20)\n"
            "    if future.done():\n"
            "        break\n"
            "assert future.result().results[0].successful, future.result()\n"
        )
        command = [sys.executable, "-c", script, node, name, str(value)]
        done = subprocess.run(command, env=self.environment, capture_output=True, text=True, timeout=150, check=False)
        assert done.returncode == 0, done.stderr

    def tail(self) -> str:
        return "last lines of the graph:\n" + "\n".join(self._log.read_text(errors="replace").splitlines()[-40:])

    def stop(self) -> int:
        """Press Ctrl-C and return bring-up's exit code."""
        self.process.send_signal(signal.SIGINT)
        try:
            return self.process.wait(60.0)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise


# What is kept of a replay, and compared with the next one


def summary(found: Results) -> dict[str, Any]:
    """Return what is recorded beside the bag."""
    return {
        "tolerances": TOLERANCES,
        "corners": {
            side: {
                str(stamp): {"count": len(rows), "places": _chosen(rows).round(3).tolist()}
                for stamp, rows in sorted(pictures.items())[::EVERY]
            }
            for side, pictures in found.corners.items()
        },
        "plane": np.median(list(found.planes.values()), axis=0).tolist(),
        "tips": {str(stamp): tip.round(7).tolist() for stamp, tip in sorted(found.tips.items())},
        "panel": found.panel.tolist(),
        "camera_from_base": found.camera.tolist(),
        "axes": found.axes.tolist(),
        "goals": [_goal(values) for values in found.goals],
    }


def _chosen(rows: np.ndarray) -> np.ndarray:
    return np.asarray(rows[np.argsort(-rows[:, 2], kind="stable")[:AMONG:EVERY_NTH], :2], np.float64)


def _goal(values: dict[str, str]) -> dict[str, Any]:
    kept = ("goal", "outcome", "reason", "error_m", "target_base_m", "effect")
    return {key: values[key] for key in kept if key in values}


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the comparison; texts, since counts, places and words stand beside one another."""

    quantity: str
    recorded: str
    now: str
    tolerance: str
    off: bool


def compare(expected: dict[str, Any], found: Results) -> list[Row]:
    """Return every quantity beside its recorded value."""
    now, bounds = summary(found), expected["tolerances"]
    rows: list[Row] = []

    def distance(quantity: str, what: str, off: float, recorded: str = "-", value: str = "") -> None:
        bad = not off <= bounds[quantity]
        rows.append(Row(f"{quantity}{what}", recorded, value or f"{off:.3g} off", f"{bounds[quantity]:g}", bad))

    for side in SIDES:
        for number, (stamp, picture) in enumerate(expected["corners"][side].items()):
            corners = found.corners[side].get(int(stamp), np.zeros((0, 3), np.float32))
            count, want = len(corners), picture["count"]
            name = f", {side} picture {number * EVERY}"
            distance("corners, count", name, abs(count - want) / want, str(want), str(count))
            gaps = _gaps(np.array(picture["places"]), corners)
            distance("corners, places [px]", name, float(np.percentile(gaps, 90)))
    for part, key in (("plane", "plane"), ("panel", "panel"), ("calibration", "camera_from_base")):
        old, new = np.array(expected[key]), np.array(now[key])
        shift = {"plane": "plane, depth [mm]", "panel": "panel, place [mm]"}.get(part, f"{part}, camera_from_base [mm]")
        # Where within the plane its points lie is not what it says of the panel.
        apart = (
            abs(float(_normal(old[3:]) @ (new[:3] - old[:3]))) if part == "plane" else np.linalg.norm(old[:3] - new[:3])
        )
        off = 1000 * float(apart)
        distance(shift, "", off, _text(old[:3]), _text(new[:3]))
        turn = f"{part}, {'normal' if part == 'plane' else 'rotation'} [deg]"
        distance(turn, "", _angle_deg(old[3:], new[3:], axis_only=part == "plane"))
    off_axes = 1000 * float(np.abs(np.array(expected["axes"]) - found.axes).max())
    distance("calibration, axes [1e-3]", "", off_axes, _text(expected["axes"]), _text(found.axes))
    both = [(np.array(tip), found.tips[int(s)]) for s, tip in expected["tips"].items() if int(s) in found.tips]
    distance(
        "tips, seen",
        "",
        len(expected["tips"]) + len(found.tips) - 2 * len(both),
        str(len(expected["tips"])),
        str(len(found.tips)),
    )
    worst = max((float(np.linalg.norm(a - b)) for a, b in both), default=float("inf"))
    distance("tips, worst [mm]", "", 1000 * worst)
    for number, want in enumerate(expected["goals"]):
        got = now["goals"][number] if number < len(now["goals"]) else {}
        for key in ("outcome", "effect"):
            if key in want:
                text = f"{want[key]} {want['reason'] if key == 'outcome' else ''}".strip()
                seen = f"{got.get(key, 'none')} {got.get('reason', '') if key == 'outcome' else ''}".strip()
                rows.append(Row(f"goal, {key}, {want['goal']}", text, seen, "the same", text != seen))
        if "target_base_m" in want:
            old, new = (np.array(g.get("target_base_m", "nan nan nan").split(), float) for g in (want, got))
            distance(
                "goal, target [mm]",
                f", {want['goal']}",
                1000 * float(np.linalg.norm(old - new)),
                _text(old),
                _text(new),
            )
        errors = [1000 * float(g.get("error_m", "nan")) for g in (want, got)]
        distance(
            "goal, seen error [mm]",
            f", {want['goal']}",
            abs(errors[0] - errors[1]),
            f"{errors[0]:.3f}",
            f"{errors[1]:.3f}",
        )
    return rows


def _gaps(places: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return for each place how far the next corner is, px."""
    if not len(corners):
        return np.full(len(places), np.inf)
    return np.asarray(np.linalg.norm(places[:, None] - corners[None, :, :2], axis=2).min(axis=1))


def _normal(turn: np.ndarray) -> np.ndarray:
    x, y, z, w = turn
    return np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])


def _angle_deg(old: np.ndarray, new: np.ndarray, *, axis_only: bool) -> float:
    if axis_only:  # a plane's pose may turn about its normal
        a, b = _normal(old), _normal(new)
        return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))
    return float(np.degrees(2 * np.arccos(min(1.0, abs(float(old @ new))))))


def _text(values: Any) -> str:
    return " ".join(f"{v:.5f}" for v in values)


def table(rows: list[Row], *, everything: bool = False) -> str:
    """Return the differences, or all rows, as text."""
    shown = [row for row in rows if row.off or everything]
    lines = [
        ("quantity", "recorded", "now", "tolerance"),
        *((r.quantity, r.recorded, r.now, r.tolerance) for r in shown),
    ]
    widths = [max(len(line[i]) for line in lines) for i in range(4)]
    return "\n".join("  ".join(text.ljust(width) for text, width in zip(line, widths)).rstrip() for line in lines)


def draw(expected: dict[str, Any], found: Results, rows: list[Row], path: Path) -> Path:
    """Write the picture whose corners differ most: recorded corners as green circles, those of now as red crosses."""
    gaps = {
        (side, int(stamp)): float(
            _gaps(np.array(picture["places"]), found.corners[side].get(int(stamp), np.zeros((0, 3)))).mean()
        )
        + abs(len(found.corners[side].get(int(stamp), ())) - picture["count"])
        for side in SIDES
        for stamp, picture in expected["corners"][side].items()
        if int(stamp) in found.corners[side]
    }
    side, stamp = (
        max(gaps, key=lambda key: gaps[key]) if gaps else ("left", int(next(iter(expected["corners"]["left"]))))
    )
    picture = _picture(side, stamp)
    for u, v in expected["corners"][side][str(stamp)]["places"]:
        cv2.circle(picture, (round(u), round(v)), 9, (0, 255, 0), 2, cv2.LINE_AA)
    for u, v in _chosen(found.corners[side].get(stamp, np.zeros((0, 3)))):
        cv2.drawMarker(picture, (round(u), round(v)), (0, 0, 255), cv2.MARKER_TILTED_CROSS, 12, 2, cv2.LINE_AA)
    note = np.full((30 + 22 * min(len([r for r in rows if r.off]), 12), picture.shape[1], 3), 255, np.uint8)
    title = f"{side} picture {stamp}: some corners recorded (green) and now (red)"
    for number, text in enumerate([title, *(f"{r.quantity}: {r.recorded} -> {r.now}" for r in rows if r.off)][:13]):
        cv2.putText(note, text[:150], (8, 20 + 22 * number), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.vstack([picture, note]))
    return path


def pictures(duration_s: float) -> dict[str, list[int]]:
    """Return the stamps of the pictures that are played within so long."""
    found: dict[str, list[int]] = {side: [] for side in SIDES}
    with BagReader(BAG) as bag:
        kinds = {topic.name: topic.type for topic in bag.topics}
        for side in SIDES:
            topic = f"/stereo/{side}/image_raw/compressed"
            for _, received_ns, data in bag.messages([topic]):
                if received_ns <= bag.start_ns + duration_s * 1e9:
                    found[side].append(_stamp(bag.decode(data, kinds[topic])))
    return found


def with_corners(whole: Results, part: Results) -> Results:
    """Return the results of a whole replay with the corners of a part of another one."""
    corners = {side: {**whole.corners[side], **part.corners[side]} for side in SIDES}
    return dataclasses.replace(whole, corners=corners)


def _picture(side: str, stamp: int) -> np.ndarray:
    with BagReader(BAG) as bag:
        topic = f"/stereo/{side}/image_raw/compressed"
        kind = next(t.type for t in bag.topics if t.name == topic)
        for _, _, data in bag.messages([topic]):
            message: Any = bag.decode(data, kind)
            if _stamp(message) == stamp:
                return np.asarray(cv2.imdecode(np.asarray(message.data, np.uint8), cv2.IMREAD_COLOR))
    raise ValueError(f"{BAG} has no {side} picture of {stamp}")


def write_expected(folder: Path, domain: int) -> None:
    """Replay the bag and keep the results beside it."""
    start = time.monotonic()
    graph = ReplayGraph(folder, domain)
    try:
        found = graph.play()
    finally:
        graph.stop()
    EXPECTED.write_text(json.dumps(summary(found), indent=1) + "\n", encoding="utf-8")
    print(f"{EXPECTED.relative_to(ROOT)}: replayed in {time.monotonic() - start:.1f} s")
