"""Measure time and memory of bag_info on a bag of 5 GB of images, a sparse file that takes little space on the disk."""

from __future__ import annotations

import argparse
import io
import resource
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path
from typing import IO, cast

from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

sys.path.append(str(Path(__file__).resolve().parents[1]))
from rows import bound, write

IMAGE, TEXT = "sensor_msgs/msg/Image", "std_msgs/msg/String"
IMAGE_BYTES, RATE_HZ, COMMANDS = 1 << 20, 30, 100
START_NS = 1_700_000_000_000_000_000
_BLOCK = 1 << 16
_ZEROS = bytes(_BLOCK)
TYPES = get_typestore(Stores.ROS2_JAZZY)


class SparseFile:
    """A writable file in which blocks of zeros are holes. It is no RawIOBase, because mcap would buffer that."""

    def __init__(self, file: Path) -> None:
        self._file = file.open("wb", buffering=0)

    def write(self, data: bytes) -> int:
        """Write bytes, or skip blocks of zeros."""
        view = memoryview(data).cast("B")
        for begin in range(0, len(view), _BLOCK):
            part = view[begin : begin + _BLOCK]
            if part == _ZEROS[: len(part)]:
                self._file.seek(len(part), io.SEEK_CUR)
            else:
                self._file.write(part)
        return len(view)

    def tell(self) -> int:
        """Return the position."""
        return self._file.tell()

    def flush(self) -> None:
        """Do nothing: the file has no buffer."""

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def write_bag(file: Path, images: int) -> None:
    with closing(SparseFile(file)) as stream:
        writer = Writer(
            cast("IO[bytes]", stream), chunk_size=IMAGE_BYTES, compression=CompressionType.NONE, enable_crcs=False
        )
        writer.start("ros2", "bench")
        kinds = {"/stereo/left/image_raw": IMAGE, "/gantry/command": TEXT, "/joint_states": TEXT}
        channels = {}
        for topic, kind in kinds.items():
            definition = TYPES.generate_msgdef(kind, ros_version=2)[0].encode()
            channels[topic] = writer.register_channel(topic, "cdr", writer.register_schema(kind, "ros2msg", definition))
        empty = b"\0\1\0\0" + bytes(IMAGE_BYTES)
        command = bytes(TYPES.serialize_cdr(TYPES.types[TEXT](data="press:RUN_STOP id=a"), TEXT))
        for number in range(images):
            stamp_ns = START_NS + number * 10**9 // RATE_HZ
            writer.add_message(channels["/stereo/left/image_raw"], stamp_ns, empty, stamp_ns)
            for step in range(10):
                writer.add_message(channels["/joint_states"], stamp_ns + step, command, stamp_ns)
            if number % (images // COMMANDS) == 0:
                writer.add_message(channels["/gantry/command"], stamp_ns, command, stamp_ns)
        writer.finish()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=int, default=5000, help="of 1 MiB each")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="bench_bag_info_") as temporary:
        file = Path(temporary) / "bag.mcap"
        write_bag(file, options.images)
        size_gb = file.stat().st_size / 1e9
        begun_s = time.monotonic()
        done = subprocess.run(
            [sys.executable, "-m", "icu_bringup.cli.bag_info", str(file)], stdout=subprocess.PIPE, check=True
        )
        took_s = time.monotonic() - begun_s
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(done.stdout.decode())
    rows = [
        bound("seconds for the overview", took_s, 10.0),
        bound("seconds of the processor", used.ru_utime + used.ru_stime, 5.0),
        bound("peak memory, MB", used.ru_maxrss / 1e3, 400.0),
    ]
    raise SystemExit(0 if write("bag_info", rows, title=f"bag_info on {size_gb:.1f} GB") else 1)


if __name__ == "__main__":
    main()
