"""Public bags, what each must give, and a matrix of the programs on them.

The bags are not part of the repository. ``PYTHONPATH=tests python -m nodes.bags.public_bags FOLDER --fetch`` downloads
those that a package has; FOLDER, or the variable ICU_PUBLIC_BAGS, may also contain a checkout of ros2/rosbag2 as
``rosbag2``. Bags of rosbag2 whose metadata.yaml is known are also written in the same structure, by other libraries
than this project's.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from support.foreign_bags import STRING, TYPES, bag, text

LOG, EVENT = "rcl_interfaces/msg/Log", "rcl_interfaces/msg/ParameterEvent"
TF, POSE = "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/PoseStamped"
EMPTY, BASIC, STRINGS = (f"test_msgs/msg/{name}" for name in ("Empty", "BasicTypes", "Strings"))
NOT_INSTALLED, BAD_NAME = "is not installed here", "topic name must not contain characters"
VARIABLE = "ICU_PUBLIC_BAGS"
ROOT = Path(__file__).parents[3]
EVO = "evo==1.38.1"


@dataclass(frozen=True, slots=True, kw_only=True)
class PublicBag:
    """A bag and what it must give.

    Attributes
    ----------
    name, origin, licence
        For the matrix.
    path
        Below the folder of public bags.
    topics
        Type and number of messages of each topic.
    missing
        Topics that cannot be played without more packages, and a part of the reason.
    is_ros1
        Whether rosbags-convert must convert it first.
    write
        Writes a bag of the same structure into a new folder; None where the structure is not known.
    """

    name: str
    origin: str
    licence: str
    path: str
    topics: Mapping[str, tuple[str, int]]
    missing: Mapping[str, str] = field(default_factory=dict)
    is_ros1: bool = False
    write: Callable[[Path], Path] | None = None

    @property
    def count(self) -> int:
        """Number of messages."""
        return sum(count for _, count in self.topics.values())

    @property
    def played(self) -> int:
        """Number of messages that the player must publish."""
        return sum(count for topic, (_, count) in self.topics.items() if topic not in self.missing)


def _message(kind: str, number: int) -> bytes:
    """Return a message; those of test_msgs, which rosbags does not know, by their CDR."""
    if kind == STRING:
        return text(f"Hello, world! {number}")
    if kind == LOG:
        stamp = TYPES.types["builtin_interfaces/msg/Time"](sec=number, nanosec=0)
        log = TYPES.types[LOG](
            stamp=stamp, level=20, name="talker", msg=f"Publishing: {number}", file="", function="", line=1
        )
        return bytes(TYPES.serialize_cdr(log, LOG))
    return b"\0\1\0\0" + (b"\0" if kind == EMPTY else bytes(48))


def _written(
    folder: Path, storage: str, topics: Mapping[str, tuple[str, int]], step_ns: int, begin_ns: int, **options: Any
) -> Path:
    rows = sorted(
        (begin_ns + number * step_ns, topic, _message(kind, number))
        for topic, (kind, count) in topics.items()
        for number in range(count)
    )
    kinds = {topic: kind for topic, (kind, _) in topics.items()}
    found = [(topic, stamp_ns, data) for stamp_ns, topic, data in rows]
    return bag(folder, ("humble", storage), found, kinds=kinds, **options)


TALKER = {"/topic": (STRING, 10), "/rosout": (LOG, 10), "/parameter_events": (EVENT, 0)}
WBAG_COUNTS = {"HHH": 726, "GGG": 731, "FFF": 772, "EEE": 804, "CCC": 742, "DDD": 753, "BBB": 742, "AAA": 804}
WBAG = {f"/{name}": (STRING, count) for name, count in WBAG_COUNTS.items()}
REWRITER_A = {"/a_empty": (EMPTY, 100), "/b_basictypes": (BASIC, 50)}
REWRITER_B = {"/c_strings": (STRINGS, 50), "/a_empty": (EMPTY, 25)}
LATCHED = {"history": 1, "depth": 1, "durability": 1}
EDITED = {"history": 1, "depth": 2, "durability": 1, "reliability": 2}


def _without_slash(topics: Mapping[str, tuple[str, int]]) -> dict[str, tuple[str, int]]:
    return {topic.lstrip("/"): value for topic, value in topics.items()}


def _talker(storage: str) -> Callable[[Path], Path]:
    """Metadata has another lifespan and another durability than the file."""

    def write(folder: Path) -> Path:
        edited = {"/rosout": {"durability": 1}, "/topic": {"durability": 2, "liveliness": 0}}
        return _written(folder, storage, TALKER, 503_455_196, 1_585_866_235_112_411_371, metadata_qos=edited)

    return write


def _wbag(storage: str) -> Callable[[Path], Path]:
    """Stamps of a few microseconds since 1970, and metadata's starting time in their middle; no offered QoS."""

    def write(folder: Path) -> Path:
        _written(folder, storage, _without_slash(WBAG), 1, 2_000, starting_ns=2_623)
        file = folder / "metadata.yaml"
        document = yaml.safe_load(file.read_text(encoding="utf-8"))
        for topic in document["rosbag2_bagfile_information"]["topics_with_message_count"]:
            topic["topic_metadata"]["offered_qos_profiles"] = ""
        file.write_text(yaml.safe_dump(document), encoding="utf-8")
        return folder

    return write


def _rewriter(storage: str, topics: Mapping[str, tuple[str, int]]) -> Callable[[Path], Path]:
    """The first message is at time 0, and metadata has other profiles than the file."""

    def write(folder: Path) -> Path:
        edited = {name.lstrip("/"): EDITED if name == "/a_empty" else LATCHED for name in topics}
        files = {name.lstrip("/"): LATCHED for name in topics}
        definitions = {EMPTY: "", BASIC: "int32 a\n", STRINGS: "string a\n"}
        return _written(
            folder,
            storage,
            _without_slash(topics),
            1_000_000,
            0,
            metadata_qos=edited,
            file_qos=files,
            definitions=definitions,
        )

    return write


def _rosbag2(name: str, part: str, topics: Mapping[str, tuple[str, int]], write: Any, *missing: str) -> list[PublicBag]:
    return [
        PublicBag(
            name=f"{name} ({storage})",
            origin="ros2/rosbag2, rosbag2_py/test/resources",
            licence="Apache-2.0",
            path=f"rosbag2/rosbag2_py/test/resources/{storage}/{part}",
            topics=topics,
            missing=dict.fromkeys(missing, NOT_INSTALLED),
            write=write(storage),
        )
        for storage in ("sqlite3", "mcap")
    ]


def _evo(name: str, path: str, topics: Mapping[str, tuple[str, int]], **more: Any) -> PublicBag:
    folder = EVO.replace("==", "-")
    return PublicBag(
        name=name, origin=f"{EVO}, sdist", licence="GPL-3.0", path=f"{folder}/{path}", topics=topics, **more
    )


_TF = {"/tf": (TF, 517), "/tf_static": (TF, 1)}
_NO_TF = {"/tf": NOT_INSTALLED, "/tf_static": NOT_INSTALLED}
BAGS = [
    *_rosbag2("talker", "talker", TALKER, _talker),
    *_rosbag2("wbag", "wbag", WBAG, _wbag),
    *_rosbag2("convert_a", "convert_a", REWRITER_A, lambda s: _rewriter(s, REWRITER_A), *REWRITER_A),
    *_rosbag2("convert_b", "convert_b", REWRITER_B, lambda s: _rewriter(s, REWRITER_B), *REWRITER_B),
    _evo(
        "ROS_example.bag",
        "test/data/ROS_example.bag",
        {"/ORB-SLAM": (POSE, 8362), "/S-PTAM": (POSE, 5439), "/groundtruth": (POSE, 12765)},
        missing={"/ORB-SLAM": BAD_NAME, "/S-PTAM": BAD_NAME},
        is_ros1=True,
    ),
    _evo("tf_example.bag", "test/data/tf_example.bag", _TF, missing=_NO_TF, is_ros1=True),
    _evo(
        "2026-04-06-16-53-32.bag",
        "test/demos/2026-04-06-16-53-32.bag",
        {
            "/fr2_desk_ORB": (POSE, 2174),
            "/fr2_desk_ORB_kf_mono": (POSE, 118),
            "/fr2_desk_groundtruth": (POSE, 20957),
        },
        is_ros1=True,
    ),
    _evo(
        "nav2_turtlebot.mcap",
        "test/data/nav2_turtlebot.mcap",
        {
            "/amcl_pose": ("geometry_msgs/msg/PoseWithCovarianceStamped", 135),
            "/odom": ("nav_msgs/msg/Odometry", 2639),
            "/tf": (TF, 5422),
            "/tf_static": (TF, 1),
        },
        missing=_NO_TF,
    ),
    _evo("tf_example", "test/data/tf_example", _TF, missing=_NO_TF),
]


def found(one: PublicBag) -> Path | None:
    """Return the path of the public bag itself; None if it is not on this computer."""
    folder = os.environ.get(VARIABLE, "")
    path = Path(folder, one.path)
    return path if folder and path.exists() else None


def fetch(folder: Path) -> None:
    """Download and unpack the package that has bags; pip checks its hash."""
    folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "pip", "download", "--no-deps", "--no-binary", ":all:", "-d", str(folder), EVO]
    subprocess.run(command, check=True, timeout=300)
    with tarfile.open(folder / f"{EVO.replace('==', '-')}.tar.gz") as archive:
        archive.extractall(folder, filter="data")


def run(program: str, *arguments: str | Path) -> tuple[int, str]:
    """Run a program of icu_bringup; return its exit code and its output."""
    command = [sys.executable, "-m", f"icu_bringup.cli.{program}", *map(str, arguments)]
    done = subprocess.run(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=300, check=False
    )
    return done.returncode, done.stdout


def convert(path: Path, folder: Path) -> Path:
    """Convert a bag of ROS 1 by rosbags-convert."""
    target = folder / f"{path.stem}_ros2"
    command = [Path(sys.executable).with_name("rosbags-convert"), "--src", path, "--dst", target]
    subprocess.run([*command, "--dst-storage", "mcap", "--dst-typestore", "ros2_jazzy"], check=True, timeout=300)
    return target


def matrix_row(one: PublicBag, path: Path, folder: Path, *, check: bool) -> str:
    """Run the programs on a bag, and return its row of the matrix."""
    codes = [run("bag_info", path)[0]]
    if one.is_ros1:
        path = convert(path, folder)
    read = re.search(r", (\d+) messages", run("bag_info", path, "--brief")[1])
    code, output = run("bag_play", path, "--wait", "0", "--rate", "1000")
    played = re.search(r"(\d+) messages played", output)
    codes += [code, run("bag_export", path, "--out", folder / "out")[0]]
    if check:
        made = ["--make", "--expect", folder / "made.yaml", "--out", folder / "report"]
        command = [ROOT / "ros2_ws" / "install" / "icu_bringup" / "lib" / "icu_bringup" / "bag_check", path, *made]
        done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, timeout=300, check=False)
        codes.append(done.returncode)
    shown = f"{one.count} / {read[1] if read else '-'} / {played[1] if played else '-'}"
    reasons = "; ".join(f"`{topic}`: {reason}" for topic, reason in one.missing.items()) or "-"
    cells = (one.name, one.origin, one.licence, shown, " ".join(map(str, codes)), reasons)
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Print the matrix of the programs on the bags in a folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the public bags")
    parser.add_argument("--fetch", action="store_true", help="download the bags that a package has into it")
    parser.add_argument("--check", action="store_true", help="run bag_check --make as well, which starts the graph")
    options = parser.parse_args()
    os.environ[VARIABLE] = str(options.folder)
    if options.fetch:
        fetch(options.folder)
    programs = "info, play, export" + (", check" if options.check else "")
    print(f"| bag | origin | licence | expected / read / played | exit codes of {programs} | not played |")
    print("|---|---|---|---|---|---|")
    for one in BAGS:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            path = found(one) or (one.write(folder / one.path.rpartition("/")[2]) if one.write else None)
            row = matrix_row(one, path, folder, check=options.check) if path else f"| {one.name} | not found |"
            print(row, flush=True)


if __name__ == "__main__":
    main()
