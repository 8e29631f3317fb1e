"""Measure bag_check on a bag of stereo images: speed, and whether runs at each load publish the same bytes.

The bag has photographs from a real stereo camera (ICU_TEST_DATA), shifted by a few pixels for each pair.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from operator import ne
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.typesys import Stores, get_typestore

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bag_writer import BagWriter
from icu_bringup.adapters.bag.bags import BagTopic

sys.path.append(str(Path(__file__).resolve().parents[1]))
from rows import bound, row, write

IMAGE, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
WIDTH, HEIGHT, RATE_HZ, PAIRS = 640, 480, 15, 149
FOCAL_PX, BASELINE_M, STEP_PX = 600.0, 0.06, 2
START_NS = 1_700_000_000_000_000_000
NODES = ("corners_left", "corners_right", "stereo")
TYPES = get_typestore(Stores.ROS2_JAZZY)


def header(stamp_ns: int, side: str) -> Any:
    time_ = TYPES.types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return TYPES.types["std_msgs/msg/Header"](stamp=time_, frame_id=f"camera_{side}_optical_frame")


def camera_info(stamp_ns: int, side: str) -> bytes:
    k = np.array([FOCAL_PX, 0, WIDTH / 2, 0, FOCAL_PX, HEIGHT / 2, 0, 0, 1])
    shift = -FOCAL_PX * BASELINE_M if side == "right" else 0.0
    p = np.insert(k, [3, 6, 9], [shift, 0.0, 0.0])
    region = TYPES.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    message = TYPES.types[INFO](
        header=header(stamp_ns, side),
        height=HEIGHT,
        width=WIDTH,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=k,
        r=np.eye(3).ravel(),
        p=p,
        binning_x=0,
        binning_y=0,
        roi=region,
    )
    return bytes(TYPES.serialize_cdr(message, INFO))


def write_bag(folder: Path, data: Path, pairs: int) -> Path:
    """Write ``pairs`` pairs of images of 640 x 480 grey pixels at 15 Hz, with camera_info."""
    photographs = {}
    for side, letter in (("left", "L"), ("right", "R")):
        read = cv2.imread(str(data / "stereo" / "aloe" / f"aloe{letter}.jpg"), cv2.IMREAD_GRAYSCALE)
        if read is None:
            raise SystemExit(f"{data} has no stereo/aloe/aloe{letter}.jpg")
        photographs[side] = cv2.resize(read, (800, 600), interpolation=cv2.INTER_AREA)
    with BagWriter(folder, keep_free=0) as writer:
        for side in photographs:
            writer.add_topic(BagTopic(name=f"/stereo/{side}/image_raw", type=IMAGE))
            writer.add_topic(BagTopic(name=f"/stereo/{side}/camera_info", type=INFO))
        for number in range(pairs):
            stamp_ns = START_NS + number * 10**9 // RATE_HZ
            x, y = (number * STEP_PX) % (800 - WIDTH), number % (600 - HEIGHT)
            for side, photograph in photographs.items():
                pixels = np.ascontiguousarray(photograph[y : y + HEIGHT, x : x + WIDTH])
                image = TYPES.types[IMAGE](
                    header=header(stamp_ns, side),
                    height=HEIGHT,
                    width=WIDTH,
                    encoding="mono8",
                    is_bigendian=0,
                    step=WIDTH,
                    data=pixels.ravel(),
                )
                writer.write(f"/stereo/{side}/image_raw", stamp_ns, bytes(TYPES.serialize_cdr(image, IMAGE)))
                writer.write(f"/stereo/{side}/camera_info", stamp_ns, camera_info(stamp_ns, side))
    return folder


def run(*arguments: str | Path) -> tuple[float, str]:
    """Run bag_check; return the seconds it took and its output."""
    command = [str(Path(sys.executable).with_name("bag_check"))]
    if not Path(command[0]).is_file():
        root = Path(__file__).parents[2]
        command = [str(root / "ros2_ws/install/icu_bringup/lib/icu_bringup/bag_check")]
    begun_s = time.monotonic()
    done = subprocess.run(
        [*command, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(done.stdout)
    return time.monotonic() - begun_s, done.stdout


def results(folder: Path) -> list[tuple[str, int, bytes]]:
    with BagReader(folder) as bag:
        return sorted(bag.messages())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--busy", type=int, nargs="+", default=[0, 8], metavar="N", help="busy programs beside it")
    parser.add_argument("--pairs", type=int, default=PAIRS)
    parser.add_argument("--nodes", nargs="+", default=NODES)
    options = parser.parse_args()
    data = Path(os.environ["ICU_TEST_DATA"])
    found, rows = [], []
    with tempfile.TemporaryDirectory(prefix="bench_bag_check_") as temporary:
        folder = Path(temporary)
        bag = write_bag(folder / "bag", data, options.pairs)
        for load in options.busy:
            seconds, replay_s = [], []
            busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(load)]
            try:
                for number in range(2):
                    expect = folder / f"load{load}_run{number}.expect.yaml"
                    making = ["--make", "--expect", expect, "--nodes", *options.nodes]
                    took_s, said = run(bag, *making, "--out", folder / f"out{load}_{number}")
                    seconds.append(f"{took_s:.1f}")
                    replay_s += [float(text) for text in re.findall(r"recording played in ([\d.]+) s", said)]
                    found.append(results(expect.with_name(f"{expect.name.removesuffix('.yaml')}_messages")))
            finally:
                for process in busy:
                    process.kill()
                    process.wait()
            print(f"{load} busy programs: the commands took {', '.join(seconds)} s")
            label = f"fastest replay, seconds for each second of the bag, {load} busy programs"
            ratio = min(replay_s) / (options.pairs / RATE_HZ)
            rows.append(row(label, ratio, None, "") if load else bound(label, ratio, 1.0))
    print(f"{len(found[0])} results of {options.pairs} pairs in each run")
    first, *others = found
    different = sum(abs(len(first) - len(other)) + sum(map(ne, first, other)) for other in others)
    rows.insert(0, bound(f"results of {len(found)} runs that differ by a byte from the first one's", different, 0))
    raise SystemExit(0 if write("bag_check", rows, title="bag_check on a bag of stereo images") else 1)


if __name__ == "__main__":
    main()
