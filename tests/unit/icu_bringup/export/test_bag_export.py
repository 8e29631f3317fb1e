"""What bag_export writes is read back with other libraries and compared with what the bag was made of."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from unit.icu_bringup.export import recorded_session as recorded

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.cli import bag_export

pytestmark = pytest.mark.slow

GOLDEN = Path(__file__).parents[3] / "golden" / "bag"
JOINTS = [row for row in recorded.rows() if row[0] == "/joint_states"]
LEFT, RIGHT = "stereo_left_image_raw_compressed", "stereo_right_image_raw"


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded.write(tmp_path_factory.mktemp("session") / "bag")


def export(bag: Path, out: Path, form: str, *more: str, code: int = 0) -> Path:
    assert bag_export.main([str(bag), "--out", str(out), "--form", form, *more]) == code
    return out / form


def table(path: Path) -> Any:
    return pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed").read_table(path)


def units(found: Any) -> dict[str, str]:
    return {field.name: field.metadata[b"unit"].decode() for field in found.schema}


def test_trailing_bytes_of_the_middleware_are_ignored() -> None:
    with BagReader(GOLDEN) as bag:
        _, _, data = next(bag.messages(["/joint_states"]))
        assert bag.decode(data, "sensor_msgs/msg/JointState").position.tolist() == [0.0, 0.0, 0.0]


def test_states_have_the_positions_of_the_bag_and_the_commanded_ones(session: Path, tmp_path: Path) -> None:
    states = table(export(session, tmp_path / "out", "parquet") / "states.parquet")
    assert units(states) == {"time_ns": "ns"} | {f"{t}{n}": "m" for t in ("", "target_") for n in recorded.NAMES}
    rows = states.to_pylist()
    assert [row["time_ns"] for row in rows] == [recorded.START_NS + round(s * 1e9) for _, s, _ in JOINTS]
    assert [[row[n] for n in recorded.NAMES] for row in rows] == [m.position.tolist() for _, _, m in JOINTS]
    # From 0.5 s on, in one second, from where the machine was to 0.11, 0.22, 0.0 m.
    begun = recorded.joints(0.5).position
    for row, (_, seconds, message) in zip(rows, JOINTS):
        part = min(max(seconds - 0.5, 0.0), 1.0)
        along = begun + part * (np.array([0.11, 0.22, 0.0]) - begun) if seconds >= 0.5 else message.position
        assert [row[f"target_{n}"] for n in recorded.NAMES] == pytest.approx(along, abs=1e-9), seconds


def test_goals_have_task_outcome_and_numbers(session: Path, tmp_path: Path) -> None:
    goals = table(export(session, tmp_path / "out", "parquet") / "goals.parquet")
    assert {n: u for n, u in units(goals).items() if u} == {
        "sent_ns": "ns",
        "accepted_ns": "ns",
        "ended_ns": "ns",
        "error_m": "m",
        "duration_s": "s",
    }
    rows = goals.to_pylist()
    assert [(r["task"], r["outcome"], r["success"], r["error_m"], r["reason"]) for r in rows] == [
        ("move to 0.1100, 0.2200, 0.0000 m in base_link", "reached", True, 0.00021, ""),
        ("press:RUN_STOP", "aborted", False, None, "stopped"),
        ("press:MENU", "rejected", False, None, "not enabled"),
    ]
    assert [(r["accepted_ns"], r["ended_ns"]) for r in rows][1] == (
        recorded.START_NS + 2_100_000_000,
        recorded.START_NS + 3_100_000_000,
    )


def test_events_have_texts_points_and_values(session: Path, tmp_path: Path) -> None:
    events = table(export(session, tmp_path / "out", "parquet") / "events.parquet")
    assert units(events)["x"].startswith("m;") and units(events)["time_ns"] == "ns"
    rows = events.to_pylist()
    texts = [r["text"] for r in rows if r["topic"] == "/gantry/command"]
    assert texts == ["press:RUN_STOP id=a1", "press:MENU id=a2"]
    [point] = [r for r in rows if r["topic"] == "/gantry/goal"]
    assert (point["x"], point["y"], point["z"], point["frame"]) == (0.11, 0.22, 0.0, "base_link")
    answers = [dict(r["values"])["outcome"] for r in rows if r["topic"] == "/gantry/result"]
    assert answers == ["accepted", "reached", "accepted", "aborted", "rejected"]


def test_the_golden_bag_is_exported_whole(tmp_path: Path) -> None:
    folder = export(GOLDEN, tmp_path / "out", "parquet")
    assert [len(table(folder / f"{n}.parquet")) for n in ("states", "goals")] == [315, 20]
    assert set(table(folder / "goals.parquet")["outcome"].to_pylist()) == {"unanswered"}


def test_images_are_those_of_the_bag(session: Path, tmp_path: Path) -> None:
    folder = export(session, tmp_path / "out", "images")
    for name, side, suffix, tolerance in ((LEFT, "left", "jpg", 3.0), (RIGHT, "right", "png", 0.0)):
        rows = list(csv.DictReader((folder / name / "frames.csv").open()))
        assert [row["file"] for row in rows] == [f"{i:06d}.{suffix}" for i in range(20)]
        stamps = [recorded.START_NS + round((0.1 + 0.2 * i) * 1e9) for i in range(20)]
        assert [(int(row["received_ns"]), int(row["stamp_ns"])) for row in rows] == list(zip(stamps, stamps))
        for i, row in enumerate(rows):
            read = cv2.imread(str(folder / name / row["file"]))
            difference = cv2.absdiff(read, recorded.picture(i, side))
            assert difference.mean() <= tolerance, (name, i)


def test_jpegs_are_copied_and_not_packed_again(session: Path, tmp_path: Path) -> None:
    folder = export(session, tmp_path / "out", "images")
    with BagReader(session) as bag:
        for i, (_, _, data) in enumerate(bag.messages(["/stereo/left/image_raw/compressed"])):
            message = bag.decode(data, "sensor_msgs/msg/CompressedImage")
            assert (folder / LEFT / f"{i:06d}.jpg").read_bytes() == bytes(message.data)


def test_videos_have_a_frame_for_each_message(session: Path, tmp_path: Path) -> None:
    folder = export(session, tmp_path / "out", "video")
    for name, side in ((LEFT, "left"), (RIGHT, "right")):
        video = cv2.VideoCapture(str(folder / name / "video.mp4"))
        assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(5.0, abs=0.01)
        for i in range(20):
            done, read = video.read()
            assert done and cv2.absdiff(read, recorded.picture(i, side)).mean() < 8, (name, i)
        assert not video.read()[0]
        assert len((folder / name / "frames.csv").read_text().splitlines()) == 21


def test_images_that_cannot_be_written_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from icu_bringup.adapters.bag.bag_writer import BagWriter
    from icu_bringup.adapters.bag.bags import BagTopic

    with BagWriter(tmp_path / "bag", "mcap") as bag:
        bag.add_topic(BagTopic(name="/camera/image_raw/compressed", type="sensor_msgs/msg/CompressedImage"))
        torn = recorded.make(
            "sensor_msgs/msg/CompressedImage", header=recorded.header(0), format="jpeg", data=np.zeros(9, np.uint8)
        )
        data = bytes(recorded.TYPES.serialize_cdr(torn, "sensor_msgs/msg/CompressedImage"))
        bag.write("/camera/image_raw/compressed", recorded.START_NS, data)
    for form in ("images", "video"):
        export(tmp_path / "bag", tmp_path / form, form, code=3)
        told = "/camera/image_raw/compressed: 1 left out: an image with the format 'jpeg' cannot be decoded\n"
        assert capsys.readouterr().err == told


def test_a_missing_library_is_named_with_its_command(
    session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for form, module, wanted in (("parquet", "pyarrow", "pyarrow>=18"), ("rerun", "rerun", "rerun-sdk==0.41.0")):
        monkeypatch.setitem(sys.modules, module, None)
        export(session, tmp_path / "out", form, code=1)
        command = f"{sys.executable} -m pip install '{wanted}'"
        assert capsys.readouterr().err == f"error: {module} is missing: install it with: {command}\n"
    assert not (tmp_path / "out").exists()


def test_a_folder_that_exists_is_left_alone(session: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    export(session, tmp_path, "images", code=1)
    assert capsys.readouterr().err == f"error: {tmp_path} exists already; name a new folder\n"


def lerobot(bag: Path, out: Path, *more: str) -> Path:
    pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    return export(bag, out, "lerobot", *more)


def test_a_lerobot_dataset_has_the_form_of_version_3(session: Path, tmp_path: Path) -> None:
    """As huggingface/lerobot declares it: datasets/utils.py (paths, info.json) and feature_utils.py (columns)."""
    folder = lerobot(session, tmp_path / "out")
    info = json.loads((folder / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0" and info["fps"] == 10 and info["splits"] == {"train": "0:2"}
    # 0.5 s to 1.9 s and 2.1 s to 3.1 s, ten times a second.
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (2, 26, 2)
    features = info["features"]
    assert features["observation.state"]["names"] == recorded.NAMES == features["action"]["names"]
    assert features["action"]["info"] == {"unit": "m"}
    assert features["observation.images.left"] == {
        "dtype": "image",
        "shape": [48, 64, 3],
        "names": ["height", "width", "channels"],
    }
    episodes = table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(e["tasks"], e["length"], e["success"]) for e in episodes] == [
        (["move to 0.1100, 0.2200, 0.0000 m in base_link"], 15, True),
        (["press:RUN_STOP"], 11, False),
    ]
    tasks = table(folder / "meta/tasks.parquet")
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    assert dict(zip(tasks["task_index"].to_pylist(), tasks["task"].to_pylist()))[1] == "press:RUN_STOP"
    for episode in episodes:
        path = info["data_path"].format(chunk_index=episode["data/chunk_index"], file_index=episode["data/file_index"])
        data = table(folder / path)
        assert set(data.column_names) == set(features)
        assert data["index"].to_pylist() == list(range(episode["dataset_from_index"], episode["dataset_to_index"]))
        assert data["timestamp"].to_pylist() == pytest.approx([i / 10 for i in range(episode["length"])])
        assert set(data["episode_index"].to_pylist()) == {episode["episode_index"]}
        assert data["next.done"].to_pylist() == [False] * (episode["length"] - 1) + [True]
        assert data["next.success"].to_pylist()[-1] is episode["success"]


def test_frames_of_a_lerobot_dataset_are_those_of_the_bag(session: Path, tmp_path: Path) -> None:
    folder = lerobot(session, tmp_path / "out")
    rows = table(folder / "data/chunk-000/file-000.parquet").to_pylist()
    for i, row in enumerate(rows):
        seconds = 0.5 + i / 10
        newest = max((s for _, s, _ in JOINTS if s <= seconds + 1e-9), default=0.0)
        assert row["observation.state"] == pytest.approx(recorded.joints(newest).position, abs=1e-7), seconds
        number = int((seconds - 0.1 + 1e-9) / 0.2)
        left = cv2.imdecode(np.frombuffer(row["observation.images.left"]["bytes"], np.uint8), cv2.IMREAD_COLOR)
        assert cv2.absdiff(left, recorded.picture(number, "left")).mean() < 2, seconds
        right = cv2.imdecode(np.frombuffer(row["observation.images.right"]["bytes"], np.uint8), cv2.IMREAD_COLOR)
        assert np.array_equal(right, recorded.picture(number, "right")), seconds
    assert rows[-1]["action"] == pytest.approx([0.11, 0.22, 0.0], abs=1e-7)
    stats = json.loads((folder / "meta/stats.json").read_text())
    states = np.array([row["observation.state"] for row in rows])
    assert stats["observation.state"]["min"] == pytest.approx(states.min(0)) and stats["action"]["count"] == [26]
    assert np.shape(stats["observation.images.left"]["mean"]) == (3, 1, 1)


def test_the_lerobot_library_loads_the_dataset(session: Path, tmp_path: Path) -> None:
    loader = pytest.importorskip("lerobot.datasets.lerobot_dataset", reason="lerobot (with torch) is not installed")
    folder = lerobot(session, tmp_path / "out")
    dataset = loader.LeRobotDataset("local/session", root=folder)
    assert (dataset.num_episodes, dataset.num_frames, dataset.fps) == (2, 26, 10)
    item = dataset[15]
    assert item["task"] == "press:RUN_STOP" and int(item["episode_index"]) == 1
    assert item["observation.state"].tolist() == pytest.approx(recorded.joints(2.1).position, abs=1e-7)
    assert item["observation.images.right"].shape == (3, 48, 64)
    rgb = (item["observation.images.right"].numpy().transpose(1, 2, 0) * 255).round().astype(np.uint8)
    assert np.array_equal(rgb[:, :, ::-1], recorded.picture(10, "right"))


@pytest.mark.parametrize(
    ("without", "reason"),
    [
        (("/gantry/result",), "needs a goal that was accepted and answered on /gantry/result"),
        (("/joint_states",), "needs images and joint positions before the end of a goal"),
        (("/stereo/left/image_raw/compressed", "/stereo/right/image_raw"), "needs images"),
    ],
)
def test_what_a_dataset_lacks_is_named(
    without: tuple[str, ...], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    export(recorded.write(tmp_path / "bag", without=without), tmp_path / "out", "lerobot", code=1)
    assert reason in capsys.readouterr().err


def test_a_namespace_names_the_robot(tmp_path: Path) -> None:
    bag = recorded.write(tmp_path / "bag", namespace="/bed2")
    folder = lerobot(bag, tmp_path / "out", "--namespace", "bed2")
    features = json.loads((folder / "meta/info.json").read_text())["features"]
    assert {"observation.images.left", "observation.images.right"} <= set(features)
