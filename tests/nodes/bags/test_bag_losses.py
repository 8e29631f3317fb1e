"""Player and recorder report missing messages by topic and end with their own exit code."""

from __future__ import annotations

import signal
import struct
import time
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest
from builtin_interfaces.msg import Time
from mcap.reader import make_reader
from nodes.bag_programs import Start
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import Header, String
from support.foreign_bags import FORMS, STRING, TYPES, bag, text
from support.ros_rig import Ros
from visualization_msgs.msg import Marker

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bag_sink import BagSink
from icu_bringup.adapters.bag.bag_writer import BagWriter
from icu_bringup.adapters.bag.bags import BagTopic
from icu_bringup.cli.bag_record import catch_up
from icu_bringup.core.bag.account import INCOMPLETE, Account
from icu_bringup.nodes.bag_recorder import BagRecorder
from icu_bringup.nodes.bag_types import installed_hash, type_problem
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import image_message

pytestmark = pytest.mark.long

START_NS = 1_700_000_000_000_000_000
ROWS = [("/talk", START_NS + i * 10_000_000, text(f"{i}")) for i in range(20)]
forms = pytest.mark.parametrize("form", FORMS, ids="-".join)
LATCHED = {"durability": 1, "depth": 1, "history": 1}
MARKER = "visualization_msgs/msg/Marker"
WORDS = QoSProfile(depth=1000)


def foxy_marker() -> bytes:
    """Return a Marker of Foxy, which has no textures."""
    data = serialize_message(Marker(ns="lab", text="a point"))
    # Fields of Jazzy after the text: texture_resource, the texture's four fields, uv_coordinates.
    at = data.index(b"a point\0") - 4
    return data[:at] + struct.pack("<I", 8) + b"a point\0" + struct.pack("<I", 1) + b"\0\0\0\0" + b"\0" * 4


EDITS = {"another QoS": {"metadata_qos": {"/talk": LATCHED}}, "a late start": {"starting_ns": START_NS + 150_000_000}}


@forms
@pytest.mark.parametrize("edit", list(EDITS))
def test_all_messages_are_played_whatever_metadata_says(
    ros: Ros, tmp_path: Path, command: Start, form: tuple[str, str], edit: str
) -> None:
    """Another QoS than that of the file, or a starting time behind the first message."""
    folder = bag(tmp_path / "bag", form, ROWS, **EDITS[edit])
    heard = ros.collect(ros.plain("listener"), String, "/talk", WORDS)
    assert command("bag_play", str(folder)).end().endswith("\n20 messages played\n")
    ros.spin_until(lambda: len(heard) == 20, 40.0, lambda: len(heard))
    assert [message.data for message in heard] == [f"{i}" for i in range(20)]


@forms
@pytest.mark.parametrize("allowed", [False, True], ids=["", "allowed"])
def test_a_bag_of_unknown_types_is_not_played_in_silence(
    tmp_path: Path, command: Start, form: tuple[str, str], allowed: bool
) -> None:
    folder = bag(tmp_path / "bag", form, ROWS, kinds={"/talk": "lab_msgs/msg/Note"})
    arguments = ["--allow-missing", "/talk"] if allowed else []
    output = command("bag_play", str(folder), "--wait", "0", *arguments).end(code=0 if allowed else INCOMPLETE)
    loss = "missing: /talk: 20 of 20 messages: not played: lab_msgs/msg/Note is not installed here"
    assert f"{loss}{' (allowed)' if allowed else ''}\n0 messages played\n" in output


@forms
def test_messages_of_an_older_definition_are_named(tmp_path: Path, command: Start, form: tuple[str, str]) -> None:
    """No subscriber could read a Marker of Foxy as one of Jazzy."""
    rows = [("/marker", START_NS + i, foxy_marker()) for i in range(3)] + ROWS
    definition = {MARKER: "string ns\nstring text\nstring mesh_resource\nbool mesh_use_embedded_materials\n"}
    folder = bag(tmp_path / "bag", form, rows, kinds={"/marker": MARKER}, definitions=definition)
    output = command("bag_play", str(folder), "--wait", "0", "--rate", "100").end(code=INCOMPLETE)
    assert f"missing: /marker: 3 of 3 messages: not played: {MARKER} has another definition here" in output
    assert output.endswith("\n20 messages played\n")


def test_messages_that_metadata_announces_and_no_file_has_are_named(tmp_path: Path, command: Start) -> None:
    folder = bag(tmp_path / "bag", ("jazzy", "mcap"), ROWS)
    described = (folder / "metadata.yaml").read_text()
    (folder / "metadata.yaml").write_text(described.replace("message_count: 20", "message_count: 25"))
    output = command("bag_play", str(folder), "--wait", "0").end(code=INCOMPLETE)
    assert "missing: /talk: 5 of 25 messages: listed in metadata.yaml, but in no file\n" in output


@forms
def test_an_excerpt_begins_with_the_last_latched_messages(
    ros: Ros, tmp_path: Path, command: Start, form: tuple[str, str]
) -> None:
    rows = [("/state", START_NS, text("old")), ("/state", START_NS + 1, text("state")), *ROWS]
    rows += [("/calibration", START_NS + 2, text("calibration"))]
    latched = {"/state": LATCHED, "/calibration": LATCHED}
    folder = bag(tmp_path / "bag", form, rows, file_qos=latched)
    listener = ros.plain("listener")
    heard: list[str] = []
    for name, profile in (("/state", qos.LATCHED), ("/calibration", qos.LATCHED), ("/talk", WORDS)):
        listener.create_subscription(String, name, lambda message: heard.append(message.data), profile)
    output = command("bag_play", str(folder), "--start-offset", "0.1").end()
    assert output.endswith("\n12 messages played\n")
    ros.spin_until(lambda: len(heard) == 12, 40.0, lambda: heard)
    assert sorted(heard[:2]) == ["calibration", "state"] and heard[2:] == [f"{i}" for i in range(10, 20)]


def test_playback_waits_until_a_slow_subscriber_is_matched(ros: Ros, tmp_path: Path, command: Start) -> None:
    """Discovery takes more than a second after the player's start, as on a busy computer."""
    program = command("bag_play", str(bag(tmp_path / "bag", ("jazzy", "mcap"), ROWS[:5])))
    watcher = ros.plain("watcher")
    ros.spin_until(lambda: watcher.count_publishers("/talk"), 40.0)
    until_s = time.monotonic() + 1.5
    ros.spin_until(lambda: time.monotonic() > until_s, 40.0)
    best_effort = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
    heard = ros.collect(ros.plain("listener"), String, "/talk", best_effort)
    program.end()
    ros.spin_until(lambda: len(heard) == 5, 40.0, lambda: len(heard))


def test_the_definition_of_each_installed_type_is_no_other_one_in_a_bag_of_ours(tmp_path: Path) -> None:
    """In a folder with hashes, and in a file with texts alone; rosbags has other hashes for some types."""
    kinds = [kind for kind in TYPES.types if "/msg/" in kind and installed_hash(kind)]
    assert {STRING, MARKER, "std_msgs/msg/Char", "sensor_msgs/msg/CameraInfo"} < set(kinds)
    with BagWriter(tmp_path / "bag", keep_free=0) as writer:
        for number, kind in enumerate(kinds):
            writer.add_topic(BagTopic(name=f"/topic_{number}", type=kind))
    for path in (tmp_path / "bag", tmp_path / "bag" / "bag.mcap"):
        with BagReader(path) as found:
            problems = {topic.type: type_problem(found, topic) for topic in found.topics}
        assert {kind: why for kind, why in problems.items() if why} == {}


BEST_EFFORT = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
KEPT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def words(path: Path, topic: str = "/words") -> list[str]:
    with BagReader(path) as found:
        return [found.decode(data, STRING).data for _, _, data in found.messages([topic])]


@pytest.mark.parametrize("first", [WORDS, KEPT], ids=["reliable", "latched"])
@pytest.mark.parametrize("second", [WORDS, BEST_EFFORT], ids=["volatile", "best effort"])
def test_a_second_publisher_of_another_qos_is_recorded(
    ros: Ros, tmp_path: Path, first: QoSProfile, second: QoSProfile
) -> None:
    talker = ros.plain("talker")
    one = talker.create_publisher(String, "words", first)
    one.publish(String(data="kept"))
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0))
    recorder = ros.node(lambda **options: BagRecorder(sink, ["words"], **options))
    ros.spin_until(one.get_subscription_count, 40.0)
    other = talker.create_publisher(String, "words", second)
    ros.spin_until(other.get_subscription_count, 40.0)
    ros.spin_until(lambda: recorder.listens, 40.0)
    for i in range(20):
        one.publish(String(data=f"one {i}"))
        other.publish(String(data=f"other {i}"))
        known = 2 * (i + 1) + (first is KEPT)
        ros.spin_until(lambda known=known: sink.messages >= known, 40.0, lambda: sink.messages)
    sink.close()
    recorder.account_for_losses()
    heard = words(tmp_path / "bag")
    kept = ["kept"] if first is KEPT else []
    assert sorted(heard) == sorted(kept + [f"{who} {i}" for who in ("one", "other") for i in range(20)])
    with BagReader(tmp_path / "bag") as found:
        offered = {(q.reliability.name, q.durability.name) for q in found.topics[0].qos}
    assert offered == {(q.reliability.name, q.durability.name) for q in (first, second)}


def test_a_publisher_that_returns_with_another_qos_is_recorded(ros: Ros, tmp_path: Path) -> None:
    talker = ros.plain("talker")
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0))
    ros.node(lambda **options: BagRecorder(sink, ["words"], **options))
    for number, profile in enumerate((KEPT, WORDS, BEST_EFFORT)):
        output = talker.create_publisher(String, "words", profile)
        ros.spin_until(output.get_subscription_count, 40.0)
        output.publish(String(data=f"{number}"))
        ros.spin_until(lambda number=number: sink.messages > number, 40.0, lambda: sink.messages)
        talker.destroy_publisher(output)
    sink.close()
    assert words(tmp_path / "bag") == ["0", "1", "2"]


def test_the_options_for_less_data_have_their_effect(ros: Ros, tmp_path: Path, command: Start) -> None:
    talker = ros.plain("talker")
    publishers = [talker.create_publisher(String, name, KEPT) for name in ("fast", "long")]
    images = talker.create_publisher(Image, "eye/image_raw", KEPT)
    for number in range(40):
        publishers[0].publish(String(data=f"{number}"))
        publishers[1].publish(String(data=f"{number}" * 4000))
    pixels = np.random.default_rng(5).integers(0, 256, (48, 64), np.uint8)
    images.publish(image_message(pixels, "mono8", Header(frame_id="eye")))
    topics = ["/fast", "/long", "/eye/image_raw"]
    # One message in 115 days.
    limits = ["--max-rate", "/fast=1e-7", "--split-size", "0.1", "--zstd", "--compress", "png"]
    program = command("bag_record", *topics, *limits, "-o", str(tmp_path / "bag"))
    for publisher in (*publishers, images):
        ros.spin_until(publisher.get_subscription_count, 40.0)
        assert publisher.wait_for_all_acked(Duration(seconds=40))
    output = program.end(signal.SIGINT)
    assert "0 dropped, 39 left out by --max-rate" in output
    assert words(tmp_path / "bag", "/fast") == ["0"]
    assert words(tmp_path / "bag", "/long") == [f"{number}" * 4000 for number in range(40)]
    with BagReader(tmp_path / "bag") as found:
        kinds = {topic.name: topic.type for topic in found.topics}
        [packed] = [found.decode(d, kinds[n]) for n, _, d in found.messages(["/eye/image_raw/compressed"])]
    assert np.array_equal(cv2.imdecode(np.asarray(packed.data), cv2.IMREAD_UNCHANGED), pixels)
    files = sorted((tmp_path / "bag").glob("*.mcap"))
    assert len(files) == 3, "280 kB of messages"
    for file in files:
        with file.open("rb") as stream:
            summary = make_reader(stream).get_summary()
        assert summary is not None and {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}


@pytest.mark.parametrize("allowed", [False, True], ids=["", "allowed"])
def test_a_name_that_returns_with_another_type_is_named(
    ros: Ros, tmp_path: Path, command: Start, allowed: bool
) -> None:
    talker = ros.plain("talker")
    output = talker.create_publisher(String, "words", KEPT)
    output.publish(String(data="word"))
    program = command(
        "bag_record", "/words", "-o", str(tmp_path / "bag"), *(["--allow-missing", "words"] if allowed else [])
    )
    ros.spin_until(output.get_subscription_count, 40.0)
    assert output.wait_for_all_acked(Duration(seconds=40))
    talker.destroy_publisher(output)
    talker.create_publisher(Header, "words", KEPT)
    assert program.process.stdout is not None
    said = "/words is not recorded: type std_msgs/msg/Header differs from std_msgs/msg/String"
    assert any(said in line for line in program.process.stdout)
    loss = f"missing: /words: all messages: not recorded: {said.partition(': ')[2]}: a topic is recorded with one type"
    ended = program.end(signal.SIGINT, code=0 if allowed else INCOMPLETE)
    assert f"{loss}{' (allowed)' if allowed else ''}\n" in ended
    assert words(tmp_path / "bag") == ["word"]


def test_messages_that_the_middleware_loses_are_counted(ros: Ros, tmp_path: Path) -> None:
    """A best-effort publisher overruns the queue of a delayed recorder."""
    output = ros.plain("talker").create_publisher(String, "words", BEST_EFFORT)
    sink, account = BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0)), Account()
    recorder = BagRecorder(sink, ["words"], account=account, context=ros.context)

    def heard() -> int:
        recorder.look()
        return int(output.get_subscription_count())

    ros.spin_until(heard, 40.0)
    output.publish(String(data="first"))
    ros.spin_until(lambda: recorder.take() or sink.messages, 40.0)
    for number in range(1500):  # the queue keeps 1000
        output.publish(String(data=f"{number}"))
    output.publish(String(data="last"))
    catch_up(recorder)
    recorder.account_for_losses()
    recorder.destroy_node()
    sink.close()
    assert 0 < account.count == 1502 - sink.messages and not account.complete
    assert account.lines() == [
        f"missing: /words: {account.count} messages: sent, and lost before the recorder received them"
    ]


def test_the_clock_of_a_simulation_is_recorded_like_any_topic(ros: Ros, tmp_path: Path) -> None:
    """The recorder runs by it, and its own subscription has bytes; it ended with a traceback."""
    clock = ros.plain("talker").create_publisher(Clock, "/clock", qos.RESULTS)
    with closing(BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0))) as sink:
        recorder = BagRecorder(sink, ["/clock"], context=ros.context)
        ros.executor.add_node(recorder)
        ros.spin_until(lambda: recorder.listens and clock.get_subscription_count() == 2, 40.0)
        for second in (100, 130):
            clock.publish(Clock(clock=Time(sec=second)))
            ros.spin_until(lambda s=second: sink.messages == (1 if s == 100 else 2), 20.0, lambda: sink.messages)
        ros.executor.remove_node(recorder)
        recorder.destroy_node()
    with BagReader(tmp_path / "bag") as found:
        seconds = [found.decode(data, "rosgraph_msgs/msg/Clock").clock.sec for _, _, data in found.messages()]
    assert seconds == [100, 130]
