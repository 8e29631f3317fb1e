"""The capture node: keeps the moments that are still and new, in both folders, and reports what is missing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Image
from std_msgs.msg import String
from unit.harris_perception.drawn_board import picture, poses

from harris_perception.core.cameras.board import CalibrationBoard
from harris_perception.core.cameras.view_collection import ViewCollection
from harris_perception.nodes.calibration_capture import CalibrationCaptureNode
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import image_message
from icu_common.nodes.messages.heads import header

BOARD = CalibrationBoard(columns=9, rows=6, square_m=0.025)


def test_still_and_new_moments_are_kept_from_both_cameras(ros: Any, tmp_path: Path) -> None:
    rng = np.random.default_rng(31)
    shown = [picture(BOARD, pose, rng) for pose in poses(rng, BOARD, 2)]
    folders = [tmp_path / side for side in ("left", "right")]
    for folder in folders:
        folder.mkdir()
    collection, lines = ViewCollection(BOARD, wanted=2), []
    topics = [f"/stereo/{side}/image_raw" for side in ("left", "right")]
    node = ros.node(lambda **o: CalibrationCaptureNode(topics, folders, collection, lines.append, **o))
    probe = ros.plain()
    reports = ros.collect(probe, DiagnosticArray, "/diagnostics")
    coverage = ros.collect(probe, String, "calibration/camera_coverage", qos.LATCHED)
    publishers = [probe.create_publisher(Image, topic, qos.IMAGES) for topic in topics]
    ros.spin_until(lambda: all(p.get_subscription_count() for p in publishers), 10)

    stamp = 1_000_000_000
    for number, gray in enumerate(shown):
        for kept in (number, number + 1):  # the first sight of a pose only shows that the board moved
            stamp += 100_000_000
            before = len(lines)
            for publisher in publishers:
                publisher.publish(image_message(gray, "mono8", header(stamp, "camera")))
            ros.spin_until(lambda k=kept, b=before: len(collection.kept) == k and len(lines) > b, 20, lambda: lines)
    for folder in folders:
        assert sorted(file.name for file in folder.iterdir()) == ["view000.png", "view001.png"]
        assert np.array_equal(cv2.imread(str(folder / "view001.png"), cv2.IMREAD_GRAYSCALE), shown[1])
    assert any("hold the board still" in line for line in lines)
    ros.spin_until(lambda: any("2/2 views" in r.status[0].message for r in reports), 10, lambda: lines)
    values = {pair.key: pair.value for pair in reports[-1].status[0].values}
    names = ("x", "y", "size", "skew")
    assert values["progress"].startswith("2/2 views; ")  # what the page shows, with the reaches
    told = {"progress", "views", "wanted", *names, *(f"{name}_missing" for name in names)}
    assert set(values) == {*told, "message", "node", "process"}
    assert (values["views"], values["wanted"]) == ("2", "2")
    assert "tilt the board" in values["skew_missing"]
    ros.spin_until(lambda: coverage and coverage[-1].data == lines[-1], 10, lambda: lines)
    assert "2/2 views; " in coverage[-1].data

    # Pictures of different moments are no pair.
    count = len(lines)
    publishers[0].publish(image_message(shown[0], "mono8", header(stamp + 200_000_000, "camera")))
    publishers[1].publish(image_message(shown[0], "mono8", header(stamp + 300_000_000, "camera")))
    publishers[0].publish(image_message(np.full_like(shown[0], 90), "mono8", header(stamp + 400_000_000, "camera")))
    publishers[1].publish(image_message(np.full_like(shown[0], 90), "mono8", header(stamp + 400_000_000, "camera")))
    ros.spin_until(lambda: any("one camera does not see the board" in line for line in lines), 20, lambda: lines)
    assert len(lines) == count + 1 and len(collection.kept) == 2

    # Cameras that run freely never give one, and a deep picture is looked at as one of 8 bits.
    for number in range(12):
        for side, late in enumerate((0, 3_200_000)):
            taken = stamp + 500_000_000 + number * 33_000_000 + late
            publishers[side].publish(image_message(shown[0], "mono8", header(taken, "camera")))
            ros.spin_until(lambda s=side, t=taken: (node._newest[s] or (0,))[0] == t, 20)
    apart = "the images of both cameras are 3.2 ms apart (limit 2)"
    ros.spin_until(lambda: any(apart in line for line in lines), 20, lambda: lines)
    before = len(lines)
    for publisher in publishers:
        deep = shown[0].astype(np.uint16) * 16
        publisher.publish(image_message(deep, "mono16", header(stamp + 2_000_000_000, "camera")))
    ros.spin_until(lambda: len(lines) > before and "hold the board still" in lines[-1], 20, lambda: lines)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_live_calibration_ends_with_one_line_in_the_background_too(
    ros: Any, tmp_path: Path, number: signal.Signals
) -> None:
    """A shell makes programs that it starts with ``&`` ignore SIGINT; rclpy handles it nevertheless."""
    program = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
    program += "from harris_perception.cli.calibrate import main; raise SystemExit(main())"
    process = subprocess.Popen(
        [sys.executable, "-c", program, "mono", str(tmp_path / "views"), "--live"],
        env={**os.environ, "ROS_DOMAIN_ID": str(ros.context.get_domain_id()), "ROS_LOG_DIR": str(tmp_path / "log")},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        assert process.stdout is not None
        while "0/20 views" not in process.stdout.readline():
            assert process.poll() is None
        process.send_signal(number)
        _, errors = process.communicate(timeout=60.0)
    assert errors.startswith("error: no view of the chessboard") and errors.count("\n") == 1
    assert process.returncode == 2
