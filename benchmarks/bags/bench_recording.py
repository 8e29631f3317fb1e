"""Measure recording of two cameras, 1280 x 960 grey at 30 Hz, and compare the MCAP writer with the official one."""

from __future__ import annotations

import argparse
import os
import re
import signal
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import rclpy
from mcap.writer import CompressionType, Writer
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Image

from icu_bringup.adapters.bag.bag_writer import BagWriter
from icu_bringup.adapters.bag.bags import BagTopic
from icu_common.nodes import qos
from icu_common.nodes.runtime import prepare_transport

sys.path.append(str(Path(__file__).resolve().parents[1]))
from rows import bound, row, write

TOPICS = ("/stereo/left/image_raw", "/stereo/right/image_raw")
RATE_HZ, WIDTH, HEIGHT = 30, 1280, 960
MESSAGES, TURNS = 300, 3
SUMMARY = re.compile(r"(\d+) messages, [\d.]+ MB, (\d+) dropped")


def image() -> bytes:
    message = Image(height=HEIGHT, width=WIDTH, encoding="mono8", step=WIDTH, data=os.urandom(WIDTH * HEIGHT))
    return bytes(serialize_message(message))


def recorded(folder: Path, seconds: float) -> tuple[int, int]:
    """Return the numbers of recorded and missing messages of a pair of cameras."""
    node = rclpy.create_node("cameras")
    outputs = [node.create_publisher(Image, topic, qos.IMAGES) for topic in TOPICS]
    command = [sys.executable, "-m", "icu_bringup.cli.bag_record", *TOPICS, "-o", str(folder / "bag")]
    program = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    while not all(output.get_subscription_count() for output in outputs):
        time.sleep(0.1)
    raw, begun_s = bytearray(image()), time.monotonic()
    for number in range(round(seconds * RATE_HZ)):
        due_s = begun_s + number / RATE_HZ
        time.sleep(max(0.0, due_s - time.monotonic()))
        raw[4:12] = struct.pack("<II", int(due_s), int(due_s % 1 * 1e9))
        for output in outputs:
            output.publish(bytes(raw))
    time.sleep(1.0)
    program.send_signal(signal.SIGINT)
    said, _ = program.communicate(timeout=60.0)
    node.destroy_node()
    found = SUMMARY.findall(said)
    if not found:
        raise SystemExit(said)
    return int(found[-1][0]), int(found[-1][1])


def ours_mb_s(folder: Path, data: bytes) -> float:
    folder.mkdir()
    writer = BagWriter(folder / "ours")
    writer.add_topic(BagTopic(name="/eye", type="sensor_msgs/msg/Image"))
    begun_s = time.process_time()
    for number in range(MESSAGES):
        writer.write("/eye", number, data)
    writer.close()
    return MESSAGES * len(data) / (time.process_time() - begun_s) / 1e6


def peer_mb_s(folder: Path, data: bytes) -> float:
    with (folder / "peer.mcap").open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start("ros2", "benchmark")
        schema = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", b"")
        channel = writer.register_channel("/eye", "cdr", schema)
        begun_s = time.process_time()
        for number in range(MESSAGES):
            writer.add_message(channel, number, data, number)
        writer.finish()
    return MESSAGES * len(data) / (time.process_time() - begun_s) / 1e6


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=15.0)
    seconds = parser.parse_args().seconds
    os.environ["ROS_DOMAIN_ID"] = str(100 + os.getpid() % 100)
    prepare_transport()
    rclpy.init()
    with tempfile.TemporaryDirectory(prefix="icu_recording_") as temporary:
        folder = Path(temporary)
        stored, missing = recorded(folder, seconds)
        data = image()
        turns = [(ours_mb_s(folder / f"{turn}", data), peer_mb_s(folder / f"{turn}", data)) for turn in range(TURNS)]
        ours, peer = (max(speeds) for speeds in zip(*turns, strict=True))
    sent = 2 * round(seconds * RATE_HZ)
    lost = 100.0 * (1.0 - stored / sent)
    rows = [
        bound("two cameras, 74 MB/s: images lost, %", lost, 0.1),
        bound("two cameras, 74 MB/s: lost images that are not reported", sent - stored - missing, 0),
        row("MCAP writer, MB per second of CPU", ours, peer, "mcap", higher_is_better=True),
    ]
    return 0 if write("recording", rows, title=__doc__ or "") else 1


if __name__ == "__main__":
    raise SystemExit(main())
