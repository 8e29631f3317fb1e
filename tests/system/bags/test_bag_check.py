"""bag_check on other people's bags: other topic names, no camera_info, Humble's storage, ROS 1, several at a time."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from golden.expectation import BAG as GOLDEN
from golden.expectation import BAG_CHECK, ROOT
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
from support.foreign_bags import TYPES, bag, text

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.core.check.expectation import from_yaml

IMAGE, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"
STAMPS = [1_700_000_000_000_000_000 + n * 66_000_000 for n in range(6)]
WIDTH, HEIGHT, DISPARITY_PX = 320, 240, 20
ROS1 = get_typestore(Stores.ROS1_NOETIC)
CALIBRATION = f"""image_width: {WIDTH}
image_height: {HEIGHT}
camera_name: left
camera_matrix: {{rows: 3, cols: 3, data: [300.0, 0.0, 160.0, 0.0, 300.0, 120.0, 0.0, 0.0, 1.0]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [0.0, 0.0, 0.0, 0.0, 0.0]}}
rectification_matrix: {{rows: 3, cols: 3, data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]}}
projection_matrix: {{rows: 3, cols: 4, data: [300.0, 0.0, 160.0, 0.0, 0.0, 300.0, 120.0, 0.0, 0.0, 0.0, 1.0, 0.0]}}
"""

pytestmark = [pytest.mark.system, pytest.mark.timeout(300), pytest.mark.long]


def image(stamp: int, number: int, types: Any = TYPES) -> Any:
    """Return a chessboard, moved a little for each number."""
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    pixels = np.where(((rows + 3 * number) // 24 + columns // 24) % 2, 200, 40).astype(np.uint8)
    time = types.types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    extra = {"seq": number} if types is ROS1 else {}
    header = types.types["std_msgs/msg/Header"](stamp=time, frame_id="cam", **extra)
    values = {"height": HEIGHT, "width": WIDTH, "encoding": "mono8", "is_bigendian": 0, "step": WIDTH}
    return types.types[IMAGE](header=header, **values, data=pixels.ravel())


def humble_bag(path: Path) -> Path:
    rows = [("/cam/image", s, bytes(TYPES.serialize_cdr(image(s, n), IMAGE))) for n, s in enumerate(STAMPS)]
    return bag(
        path, ("humble", "sqlite3"), [*rows, ("/chatter", STAMPS[0], text("hello"))], kinds={"/cam/image": IMAGE}
    )


def ros1_bag(path: Path) -> Path:
    with Writer(path) as writer:
        connection = writer.add_connection("/cam/image", IMAGE, typestore=ROS1)
        for number, stamp in enumerate(STAMPS):
            writer.write(connection, stamp, ROS1.serialize_ros1(image(stamp, number, ROS1), IMAGE))
    return path


def check(folder: Path, *arguments: str | Path, code: int = 0) -> str:
    command = [str(part) for part in (BAG_CHECK, *arguments, "--out", folder / "report")]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == code, f"{done.stdout}{done.stderr}"
    return done.stdout + done.stderr


def making(folder: Path) -> list[str | Path]:
    calibration = folder / "left.yaml"
    calibration.write_text(CALIBRATION, encoding="utf-8")
    left = ["--left", "/cam/image", "--camera-info", calibration]
    return ["--make", "--nodes", "corners_left", *left, "--topics", "/stereo/left/corners"]


def test_a_bag_with_other_names_and_without_camera_info(tmp_path: Path) -> None:
    theirs = humble_bag(tmp_path / "theirs")
    check(tmp_path, theirs, *making(tmp_path))
    made = from_yaml((tmp_path / "theirs.expect.yaml").read_text(encoding="utf-8"))
    assert made.topics["/stereo/left/corners"].messages == len(STAMPS)
    assert made.run.left == "/cam/image" and made.run.nodes == ("corners_left",)
    assert made.run.camera_info == ("left.yaml",), "relative: the folder may be cloned elsewhere"
    check(tmp_path, theirs)
    rows = json.loads((tmp_path / "report" / "fields.json").read_text(encoding="utf-8"))
    points = next(row for row in rows if row["field"] == "points")
    assert points["compared"] == len(STAMPS) and points["passed"] and int(points["expected"].split()[0]) > 50
    output = check(tmp_path, theirs, "--set", "corners_left.max_corners=20", code=1)
    assert "/stereo/left/corners  points" in output and "20 points" in output
    suite = ElementTree.parse(tmp_path / "report" / "junit.xml").find("testsuite")
    assert suite is not None and suite.get("failures") == "1"
    assert (tmp_path / "report" / "stereo_left_corners.points.png").is_file()


def stereo_bag(path: Path) -> Path:
    """Return a bag with a textured plane at 0.9 m: a disparity of 20 px."""
    noise = np.random.default_rng(5).integers(0, 256, (HEIGHT // 4, WIDTH // 4 + 5), np.uint8)
    texture = np.kron(noise, np.ones((4, 4), np.uint8))
    rows, kinds = [], {}
    for side, shift in (("left", 0), ("right", DISPARITY_PX)):
        kinds[f"/{side}/image"] = IMAGE
        for number, stamp in enumerate(STAMPS[::2]):
            message = image(stamp, number)
            message.data = np.ascontiguousarray(texture[:, shift : shift + WIDTH]).ravel()
            rows.append((f"/{side}/image", stamp, bytes(TYPES.serialize_cdr(message, IMAGE))))
    return bag(path, ("humble", "sqlite3"), rows, kinds=kinds)


def test_dense_stereo_takes_part(tmp_path: Path) -> None:
    theirs = stereo_bag(tmp_path / "theirs")
    for side, shift in (("left", "0.0"), ("right", "-18.0")):
        text_ = CALIBRATION.replace("160.0, 0.0, 0.0, 300.0", f"160.0, {shift}, 0.0, 300.0")
        (tmp_path / f"{side}.yaml").write_text(text_, encoding="utf-8")
    images = ["--left", "/left/image", "--right", "/right/image"]
    images += ["--camera-info", tmp_path / "left.yaml", tmp_path / "right.yaml"]
    topics = ["/stereo/dense_points", "/stereo/disparity"]
    check(tmp_path, theirs, "--make", "--nodes", "dense_stereo", *images, "--topics", *topics)
    made = from_yaml((tmp_path / "theirs.expect.yaml").read_text(encoding="utf-8"))
    assert {topic: value.messages for topic, value in made.topics.items()} == dict.fromkeys(topics, 3)
    with BagReader(tmp_path / "theirs.expect_messages") as found:
        kind = "stereo_msgs/msg/DisparityImage"
        disparity = next(found.decode(data, kind).image for _, _, data in found.messages([topics[1]]))
    values = np.frombuffer(disparity.data.tobytes(), np.float32)
    assert np.nanmedian(np.where(values > 0, values, np.nan)) == pytest.approx(DISPARITY_PX / 2, abs=0.2), "binning 2"
    check(tmp_path, theirs)


def test_recognition_and_readouts_take_part(tmp_path: Path) -> None:
    """The beginning of the golden bag: the panel's lamps and the positions of its knobs."""
    theirs = shutil.copytree(GOLDEN, tmp_path / "theirs")
    nodes = ["corners_left", "corners_right", "stereo", "recognition"]
    part = ["--exclude", "/bag/cue", "--duration", "2"]
    check(tmp_path, theirs, "--make", "--nodes", *nodes, "--topics", "/panel/state", *part)
    made = from_yaml((tmp_path / "theirs.expect.yaml").read_text(encoding="utf-8"))
    fields = made.topics["/panel/state"].fields
    assert fields["status[*].values.angle_deg"].limits == {"absolute": 0.05}
    with BagReader(tmp_path / "theirs.expect_messages") as found:
        kind = "diagnostic_msgs/msg/DiagnosticArray"
        states = [found.decode(data, kind).status for _, _, data in found.messages(["/panel/state"])]
    assert len(states) == made.topics["/panel/state"].messages > 1
    for state in states:
        values = {control.name: {pair.key: pair.value for pair in control.values} for control in state}
        assert values["RUN_STOP"]["lamp"] == "green" and abs(float(values["CH1_SCALE"]["angle_deg"])) < 3.0
    check(tmp_path, theirs)
    rows = json.loads((tmp_path / "report" / "fields.json").read_text(encoding="utf-8"))
    compared = [row["field"].partition(".values.")[2] for row in rows if row["compared"] == len(states)]
    assert compared.count("lamp") == 3 and compared.count("angle_deg") == 7, rows


def test_a_ros_1_bag_is_converted(tmp_path: Path) -> None:
    theirs = ros1_bag(tmp_path / "old.bag")
    check(tmp_path, theirs, *making(tmp_path))
    made = from_yaml((tmp_path / "old.bag.expect.yaml").read_text(encoding="utf-8"))
    assert made.topics["/stereo/left/corners"].messages == len(STAMPS)
    check(tmp_path, theirs)


def test_several_bags_at_a_time_have_a_report_each(tmp_path: Path) -> None:
    bags = [humble_bag(tmp_path / name) for name in ("first", "second")]
    check(tmp_path, *bags, *making(tmp_path), "-j", "2")
    output = check(tmp_path, *bags, "-j", "2")
    for name in ("first", "second"):
        assert f"{name}: as expected" in output
        assert (tmp_path / "report" / name / "summary.md").read_text(encoding="utf-8").startswith("### ✅ " + name)


def test_what_cannot_run_is_code_2_with_the_reason(tmp_path: Path) -> None:
    theirs = humble_bag(tmp_path / "theirs")
    assert "does not exist; make it with: bag_check BAG --make" in check(tmp_path, theirs, code=2)
    made = ["--make", "--nodes", "corners_left"]
    output = check(tmp_path, theirs, *made, code=2)
    assert "has none of the topics that the nodes read" in output and "/cam/image" in output
    suite = ElementTree.parse(tmp_path / "report" / "junit.xml").find("testsuite")
    assert suite is not None and suite.get("errors") == "1"
    assert "has no /other; its images are /cam/image" in check(tmp_path, theirs, *made, "--left", "/other", code=2)
    assert "no node corner; there are corners_left" in check(tmp_path, theirs, "--make", "--nodes", "corner", code=2)
    assert "--left: the expectation has these" in check(tmp_path, theirs, "--left", "/cam/image", code=2)
    assert "--expect is for one bag" in check(tmp_path, theirs, theirs, "--expect", "x.yaml", code=2)


HOW_TO = ROOT / "docs" / "how-to" / "bag_in_ci.md"


def test_the_snippets_of_the_how_to_run_the_same_steps(tmp_path: Path) -> None:
    """The shell's steps are executed here; those of GitHub and GitLab must be these."""
    blocks = re.findall(r"```(\w+)\n(.*?)```", HOW_TO.read_text(encoding="utf-8"), re.DOTALL)
    shell = next(body for kind, body in blocks if kind == "bash" and "git clone" in body)
    steps = [line for line in shell.splitlines() if line and not line.startswith("#")]
    github, gitlab = (yaml.safe_load(body) for kind, body in blocks if kind == "yaml" and "bag_check" in body)
    given = [step["run"] for step in github["jobs"]["bags"]["steps"] if "run" in step]
    assert [line for run in given for line in run.strip().splitlines()] == steps
    assert gitlab["bags"]["script"] == steps
    assert (ROOT / "scripts" / "setup.sh").is_file()
    assert any(step.startswith("robot/scripts/setup.sh") for step in steps)
    (tmp_path / "robot").symlink_to(ROOT)
    (tmp_path / "bags").mkdir()
    for name in ("first", "second"):
        check(tmp_path, humble_bag(tmp_path / "bags" / name), *making(tmp_path))
    run = [step for step in steps if not step.startswith(("git clone", "robot/scripts/setup.sh"))]
    done = subprocess.run(["bash", "-euc", "\n".join(run)], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{done.stdout}{done.stderr}"
    assert "first: as expected" in done.stdout and "second: as expected" in done.stdout
