"""Measure the latency from an image's stamp to its corners through the graph: three processes, 1280x720 bgr8 at 30 Hz.

One process publishes, one is the corners node, this one receives. The peer is the same node with goodFeaturesToTrack in
place of the detector, so that transport, conversion and executor are the same for both. An image counts as lost if its
corners have not arrived one second after the last image was sent. Images before the first answered one are counted
separately: the camera's middleware may discover the node before the node has discovered the camera.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rclpy
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Image, PointCloud2

from harris_perception.core.corners.harris import Corners, HarrisConfig
from harris_perception.nodes.corners_node import CornersNode
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import image_message
from icu_common.nodes.messages.heads import header, stamp_ns
from icu_common.nodes.runtime import prepare_transport, run

sys.path.append(str(Path(__file__).resolve().parents[1]))
from perception.bench_harris import picture
from rows import Row, bound, row, write

RATE_HZ = 30.0
SETTINGS = HarrisConfig(gradient="sobel")


class Camera(Node):
    """Publishes ``count`` images at the rate once the corners node subscribes, then ends."""

    def __init__(self, count: int) -> None:
        super().__init__("camera")
        gray = picture(1280, 720)
        shifted = [np.roll(gray, 7 * i, axis=1) for i in range(8)]
        self.left = self._count = count
        self._pictures = [cv2.merge([p, p, p]) for p in shifted]
        self._publisher = self.create_publisher(Image, "image_raw", qos.IMAGES)
        self.create_timer(1.0 / RATE_HZ, self._publish)

    def _publish(self) -> None:
        if self._publisher.get_subscription_count() == 0 or self.left == 0:
            return
        head = header(self.get_clock().now().nanoseconds, f"camera_{self._count - self.left}")
        self._publisher.publish(image_message(self._pictures[self.left % len(self._pictures)], "bgr8", head))
        self.left -= 1

    def wait_until_received(self) -> None:
        """Wait until the readers have received all images; otherwise the last one would be lost with the publisher."""
        self._publisher.wait_for_all_acked(Duration(seconds=2))


class GoodFeatures:
    """cv2.goodFeaturesToTrack with the interface of HarrisDetector."""

    def detect(self, gray: np.ndarray) -> Corners:
        found = cv2.goodFeaturesToTrack(gray, 2000, 0.01, 0, blockSize=3, useHarrisDetector=True, k=0.04)
        xy = np.empty((0, 2), np.float32) if found is None else found.reshape(-1, 2)
        return Corners(xy, np.ones(len(xy), np.float32))

    def warm(self) -> None:
        self.detect(np.zeros((20, 20), np.uint8))


class PeerNode(CornersNode):
    def _use(self, config: HarrisConfig) -> None:
        cv2.setNumThreads(1)
        self._corner_detector: Any = GoodFeatures()


def publish(count: int) -> int:
    prepare_transport()
    rclpy.init()
    camera = Camera(count)
    executor = SingleThreadedExecutor()
    executor.add_node(camera)
    while camera.left:
        executor.spin_once(timeout_sec=0.1)
    camera.wait_until_received()
    executor.shutdown()
    camera.destroy_node()
    rclpy.try_shutdown()  # Ctrl-C has already shut it down
    return 0


@contextmanager
def process(*arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    started = subprocess.Popen([sys.executable, *arguments])
    try:
        yield started
    finally:
        if started.poll() is None:
            started.send_signal(signal.SIGINT)
            try:
                started.wait(10)
            except subprocess.TimeoutExpired:
                started.kill()
                started.wait()


def cpu_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(node_arguments: list[str], count: int) -> dict[str, float]:
    rclpy.init()
    probe = Node("probe")
    ages_ms: list[float] = []
    numbers: list[int] = []

    def on_corners(cloud: PointCloud2) -> None:
        numbers.append(int(cloud.header.frame_id.rpartition("_")[2]))
        ages_ms.append((probe.get_clock().now().nanoseconds - stamp_ns(cloud.header.stamp)) / 1e6)

    probe.create_subscription(PointCloud2, "corners", on_corners, qos.RESULTS)
    executor = SingleThreadedExecutor()
    executor.add_node(probe)
    try:
        with process(*node_arguments) as node:
            deadline = time.monotonic() + 60.0
            while probe.count_publishers("corners") == 0 and time.monotonic() < deadline and node.poll() is None:
                executor.spin_once(timeout_sec=0.1)
            with process(__file__, "--publish", str(count)) as camera:
                deadline = time.monotonic() + 60.0
                while not ages_ms and time.monotonic() < deadline:
                    executor.spin_once(timeout_sec=0.1)
                start, busy = time.monotonic(), cpu_s(node.pid)
                while camera.poll() is None and time.monotonic() < start + 3 * count / RATE_HZ:
                    executor.spin_once(timeout_sec=0.1)
                cpu = (cpu_s(node.pid) - busy) / (time.monotonic() - start)
                deadline = time.monotonic() + 1.0
                while numbers and numbers[-1] < count - 1 and time.monotonic() < deadline:
                    executor.spin_once(timeout_sec=0.1)
    finally:
        executor.shutdown()
        probe.destroy_node()
        rclpy.try_shutdown()
    if not ages_ms:
        raise SystemExit("no corners came: " + " ".join(node_arguments))
    p50, p99 = np.percentile(ages_ms, (50, 99))
    early = numbers[0]
    lost = count - early - len(numbers)
    return {"p50 [ms]": float(p50), "p99 [ms]": float(p99), "early": early, "lost": lost, "cpu [%]": 100.0 * cpu}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--publish", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--peer", action="store_true", help=argparse.SUPPRESS)
    arguments, _ = parser.parse_known_args()
    if arguments.publish:
        return publish(arguments.publish)
    if arguments.peer:
        return run(PeerNode, [])
    os.environ.setdefault("ROS_DOMAIN_ID", str(100 + os.getpid() % 100))
    prepare_transport()
    count = int(arguments.seconds * RATE_HZ)
    ours = measure(["-m", "harris_perception.nodes.corners_node", "--ros-args", "-p", "gradient:=sobel"], count)
    peer = measure([__file__, "--peer"], count)
    what = "1280x720 bgr8, 30 Hz"
    name = "same node, cv2.goodFeaturesToTrack"
    rows: list[Row] = [row(f"{what}: stamp to corners, {k}", ours[k], peer[k], name) for k in ("p50 [ms]", "p99 [ms]")]
    rows.append(row(f"{what}: one core of the node, cpu [%]", ours["cpu [%]"], peer["cpu [%]"], name))
    early = f"before the first {ours['early']:.0f}, peer {peer['early']:.0f}"
    rows.append(bound(f"{what}: pictures of {count} without corners (peer {peer['lost']}; {early})", ours["lost"], 0))
    write("graph_latency", rows, title="picture to corners through the graph")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
