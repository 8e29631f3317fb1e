"""Recorder and player in front of live topics: the same bytes come out, in the same order, latched ones included."""

from __future__ import annotations

import contextlib
import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import nav_msgs.msg
import numpy as np
import pytest
from builtin_interfaces.msg import Time
from geometry_msgs.msg import PointStamped
from nodes.background import output_in_background
from nodes.bag_programs import Command, Start
from rclpy.duration import Duration
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CompressedImage, Image, PointCloud2
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger
from support.ros_rig import Ros

from icu_bringup.adapters.bag.bag_pictures import PictureCodec
from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bag_sink import BagSink
from icu_bringup.adapters.bag.bag_writer import BagWriter
from icu_bringup.adapters.bag.bags import BagError, BagTopic
from icu_bringup.cli.bag_record import catch_up
from icu_bringup.core.bag.account import INCOMPLETE
from icu_bringup.nodes.bag_player import BagPlayer
from icu_bringup.nodes.bag_qos import playing_qos, recorded_qos
from icu_bringup.nodes.bag_recorder import BagRecorder
from icu_bringup.nodes.topic_ear import TopicEar
from icu_common.adapters.steps.step_ledger import LEDGER_VARIABLE, StepLedger
from icu_common.nodes import qos
from icu_common.nodes.messages.cameras import image_array, image_message
from icu_common.nodes.messages.heads import header

pytestmark = pytest.mark.long

ROOT = Path(__file__).resolve().parents[3]
WHOLE = QoSProfile(depth=1000)
"""All messages of a test, however long who listens is held up."""


class Toggle:
    """The player's service that pauses and resumes it."""

    def __init__(self, ros: Ros, node: Node) -> None:
        self._ros, self._client = ros, node.create_client(Trigger, "/bag_player/toggle_paused")
        ros.spin_until(self._client.service_is_ready, 40.0)

    def until(self, wanted: str) -> None:
        """Ask until the answer is ``wanted``: one is lost when the player does not know of its client yet."""
        asked: list[tuple[float, Any]] = []

        def answered() -> bool:
            if asked and asked[-1][1].done() and asked[-1][1].result().message == wanted:
                return True
            if not asked or asked[-1][1].done() or time.monotonic() > asked[-1][0] + 4.0:
                asked.append((time.monotonic(), self._client.call_async(Trigger.Request())))
            return False

        self._ros.spin_until(answered, 40.0, lambda: len(asked))


def numbered_bag(path: Path, topics: Sequence[str], messages: int) -> Path:
    """Write a bag of std_msgs/String with the numbers of its messages, 20 ms from one to the next."""
    with BagWriter(path, keep_free=0) as bag:
        for name in topics:
            bag.add_topic(BagTopic(name=name, type="std_msgs/msg/String"))
        for i in range(messages):
            for name in topics:
                bag.write(name, 10**9 + 20_000_000 * i, serialize_message(String(data=f"{i}")))
    return path


def test_pictures_beside_compressed_ones_of_somebody_else_are_played_each_where_it_was(ros: Ros) -> None:
    kind = "sensor_msgs/msg/CompressedImage"
    topics = [BagTopic(name=name, type=kind) for name in ("/a/bag_record/compressed", "/a/compressed", "/b/compressed")]
    player = ros.node(lambda **options: BagPlayer(topics, **options))
    played = dict(player.get_publisher_names_and_types_by_node("bag_player", "/"))
    assert {name: types for name, types in played.items() if name[:2] in ("/a", "/b")} == {
        "/a": ["sensor_msgs/msg/Image"],
        "/a/compressed": [kind],
        "/b": ["sensor_msgs/msg/Image"],
    }


def test_pictures_that_were_recorded_as_they_are_and_compressed_are_played_each_where_it_was(
    ros: Ros, tmp_path: Path, command: Start
) -> None:
    """As image_transport publishes them. Of ours each is either compressed or, where it cannot be, as it was."""
    with BagWriter(tmp_path / "bag", keep_free=0) as bag:
        for name, message, stamps in (
            ("/ours", Image, [1, 3]),
            ("/ours/compressed", CompressedImage, [2, 4]),
            ("/theirs", Image, [1, 2, 3]),
            ("/theirs/compressed", CompressedImage, [2, 3, 4]),
        ):
            bag.add_topic(BagTopic(name=name, type=f"sensor_msgs/msg/{message.__name__}"))
            for stamp in stamps:
                bag.write(name, 10 * stamp, serialize_message(message(header=header(stamp, "eye"))))
    command("bag_play", str(tmp_path / "bag"), "--start-paused")
    listener = ros.plain("listener")

    def played() -> list[tuple[str, int]]:
        names = sorted(name for name, _ in listener.get_topic_names_and_types())
        return [(name, listener.count_publishers(name)) for name in names if name.startswith(("/ours", "/theirs"))]

    ros.spin_until(lambda: sum(count for _, count in played()) == 4, 40.0, played)
    assert played() == [("/ours", 2), ("/theirs", 1), ("/theirs/compressed", 1)]


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_what_is_recorded_is_played_again(ros: Ros, tmp_path: Path, storage: str, command: Start) -> None:
    talker = ros.plain("talker")
    state = talker.create_publisher(String, "robot/state", qos.LATCHED)
    words = talker.create_publisher(String, "words", qos.RESULTS)
    state.publish(String(data="ready"))
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", storage, keep_free=0))
    recorder = ros.node(lambda **options: BagRecorder(sink, ["robot/state", "words", "silent"], **options))
    ros.spin_until(lambda: words.get_subscription_count() and state.get_subscription_count(), 40.0)
    for i in range(50):
        words.publish(String(data=f"word {i}"))
        # The publisher keeps ten, more than that could be lost before the recorder has read them.
        ros.spin_until(lambda i=i: sink.messages > i, 40.0, lambda: (sink.messages, sink.failure))
    ros.spin_until(lambda: sink.messages == 51, 40.0, lambda: (sink.messages, sink.failure))
    assert recorder.missing == ["/silent"]
    sink.close()
    assert (sink.failure, sink.dropped) == ("", 0)
    with BagReader(tmp_path / "bag") as bag:
        kinds = {t.name: [(q.reliability.name, q.durability.name) for q in t.qos] for t in bag.topics}
        spoken = [bag.decode(d, "std_msgs/msg/String").data for t, _, d in bag.messages(["/words"])]
        recorded = bag.duration_ns
    assert kinds == {"/robot/state": [("RELIABLE", "TRANSIENT_LOCAL")], "/words": [("RELIABLE", "VOLATILE")]}
    assert spoken == [f"word {i}" for i in range(50)]
    ros.executor.remove_node(talker)
    ros.nodes.remove(talker)
    talker.destroy_node()

    listener = ros.plain("listener")
    heard = ros.collect(listener, String, "/words", QoSProfile(depth=100))
    latched = ros.collect(listener, String, "/robot/state", qos.LATCHED)
    times = ros.collect(listener, Clock, "/clock", qos.RESULTS)
    player = command("bag_play", str(tmp_path / "bag"), "--clock", "100", "--wait", "10", "--rate", "0.5")
    ros.spin_until(lambda: len(heard) == 50 and latched, 40.0, lambda: (len(heard), len(latched)))
    assert "51 messages played" in player.end()
    assert [m.data for m in heard] == spoken and latched[-1].data == "ready"
    stamps = [m.clock.sec * 10**9 + m.clock.nanosec for m in times]
    assert stamps == sorted(stamps) and stamps[-1] - stamps[0] <= recorded + 1e9


@pytest.mark.skipif(
    not hasattr(nav_msgs.msg, "Goals") or "nav_msgs/msg/Goals" in get_typestore(Stores.ROS2_JAZZY).types,
    reason="a type is needed that is installed and that bags cannot describe",
)
def test_a_topic_whose_definition_is_not_known_does_not_end_the_recording(ros: Ros, tmp_path: Path) -> None:
    """Any program on this computer may publish a type that bags cannot describe; the robot's topics are recorded."""
    talker = ros.plain("talker")
    talker.create_publisher(nav_msgs.msg.Goals, "goals", qos.RESULTS)
    words = talker.create_publisher(String, "words", qos.RESULTS)
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0))
    recorder = ros.node(lambda **options: BagRecorder(sink, ["goals", "words"], **options))
    ros.spin_until(lambda: words.get_subscription_count() and not recorder.missing, 40.0, lambda: recorder.missing)
    words.publish(String(data="ready"))
    ros.spin_until(lambda: sink.messages == 1 or sink.failure, 40.0)
    sink.close()
    assert (sink.failure, sink.dropped, recorder.recorded) == ("", 0, {"/words"})
    with BagReader(tmp_path / "bag") as bag:
        assert [(topic.name, topic.count) for topic in bag.topics] == [("/words", 1)]


def test_a_player_keeps_what_is_recorded_for_latecomers_and_never_less_than_fifty_for_the_others() -> None:
    for recorded, depth in ((qos.RESULTS, 50), (qos.LATCHED, qos.LATCHED.depth), (QoSProfile(depth=80), 80)):
        offered = playing_qos([recorded_qos(recorded)])
        assert (offered.depth, offered.reliability, offered.durability) == (
            depth,
            recorded.reliability,
            recorded.durability,
        )


def test_loop_filter_pause_and_no_orders(ros: Ros, tmp_path: Path, command: Start) -> None:
    with BagWriter(tmp_path / "bag", keep_free=0) as bag:
        kinds = {"/a": "String", "/b": "String", "/gantry/sequence": "String", "/operator/heartbeat": "Header"}
        kinds["/bed_1/gantry/trajectory"] = "String"
        for name, kind in kinds.items():
            bag.add_topic(BagTopic(name=name, type=f"std_msgs/msg/{kind}", qos=(recorded_qos(WHOLE),)))
        for i in range(4):
            stamp_ns = 10**9 + 20_000_000 * i
            bag.write("/a", stamp_ns, serialize_message(String(data=f"{i}")))
            bag.write("/b", stamp_ns, serialize_message(String(data=f"{i}")))
            bag.write("/gantry/sequence", stamp_ns, serialize_message(String(data="steps: ['press:MENU']")))
            bag.write("/bed_1/gantry/trajectory", stamp_ns, serialize_message(String(data=f"way {i}")))
            bag.write("/operator/heartbeat", stamp_ns, serialize_message(Header(stamp=Time(sec=i))))
    listener = ros.plain("listener")
    a = ros.collect(listener, String, "/a", qos.RESULTS)
    b = ros.collect(listener, String, "/b", qos.RESULTS)
    beats = ros.collect(listener, Header, "/operator/heartbeat", qos.RESULTS)
    orders = ros.collect(listener, String, "/bed_1/gantry/trajectory", qos.RESULTS)
    ways = ros.collect(listener, String, "/bed_1/gantry/recorded_trajectory", qos.RESULTS)
    player = command("bag_play", str(tmp_path / "bag"), "--loop", "--start-paused", "--exclude", "/b")
    toggle = Toggle(ros, listener)
    assert a == []
    toggle.until("playing")
    ros.spin_until(lambda: len(a) >= 9, 40.0, lambda: len(a))
    output = player.end(signal.SIGINT)
    assert [m.data for m in a[:9]] == ["0", "1", "2", "3", "0", "1", "2", "3", "0"]
    assert b == [] and beats == [] and orders == []
    assert [m.data for m in ways[:2]] == ["way 0", "way 1"], "where it went can be seen"
    assert "not played: /b, /gantry/sequence, /operator/heartbeat\n" in output


def test_the_end_of_a_recording_is_in_it_when_the_recorder_is_behind(ros: Ros, tmp_path: Path) -> None:
    words = ros.plain("talker").create_publisher(String, "words", QoSProfile(depth=800))
    executor = EventsExecutor(context=ros.context)  # as that of the program
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0))
    recorder = BagRecorder(sink, ["words"], context=ros.context)
    executor.add_node(recorder)
    ros.spin_until(lambda: executor.spin_once(timeout_sec=0.02) or words.get_subscription_count(), 40.0)
    for number in range(800):  # no thread serves the recorder meanwhile
        words.publish(String(data=f"{number}"))
    assert words.wait_for_all_acked(Duration(seconds=10))
    catch_up(recorder)
    executor.remove_node(recorder)
    recorder.destroy_node()
    sink.close()
    with BagReader(tmp_path / "bag") as bag:
        spoken = [bag.decode(data, "std_msgs/msg/String").data for _, _, data in bag.messages()]
    assert spoken == [f"{number}" for number in range(800)]


def test_a_message_has_the_time_at_which_it_came_however_late_it_is_taken(ros: Ros, tmp_path: Path) -> None:
    """A motion whose beginning and end are taken together would be none when it is played."""
    talker = ros.plain("talker")
    outputs = {"/words": talker.create_publisher(String, "words", WHOLE)}
    outputs["/eye"] = talker.create_publisher(Image, "eye", WHOLE)
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0))
    recorder = BagRecorder(sink, list(outputs), context=ros.context)  # no thread serves it

    def heard() -> bool:
        recorder.look()
        return all(output.get_subscription_count() for output in outputs.values())

    ros.spin_until(heard, 40.0)
    ways: list[tuple[int, int]] = []
    for _ in range(3):
        begun_ns = time.time_ns()
        for output in outputs.values():
            output.publish(output.msg_type())
            assert output.wait_for_all_acked(Duration(seconds=10))
        ways.append((begun_ns, time.time_ns()))
        until_s = time.monotonic() + 0.2
        ros.spin_until(lambda until_s=until_s: time.monotonic() > until_s, 5.0)
    catch_up(recorder)
    recorder.destroy_node()
    sink.close()
    with BagReader(tmp_path / "bag") as bag:
        for name in outputs:
            came = [stamp_ns for _, stamp_ns, _ in bag.messages([name])]
            assert len(came) == 3, name
            assert all(begun <= ns <= ended for ns, (begun, ended) in zip(came, ways, strict=True)), (name, came, ways)


def test_recording_of_a_simulation_has_the_times_of_its_clock(ros: Ros, tmp_path: Path) -> None:
    """Its messages have stamps of that clock; next to later ones they would all be old."""
    talker = ros.plain("talker")
    words, clock = (
        talker.create_publisher(String, "words", WHOLE),
        talker.create_publisher(Clock, "/clock", qos.RESULTS),
    )
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0))
    recorder = BagRecorder(sink, ["words", "/clock"], context=ros.context)
    ros.executor.add_node(recorder)
    # Its own time, and its recording of it.
    ros.spin_until(lambda: words.get_subscription_count() and clock.get_subscription_count() == 2, 40.0)
    words.publish(String(data="before the first time"))
    assert words.wait_for_all_acked(Duration(seconds=10))
    assert recorder.take() == 0, "it waits for the time"
    for second in (100, 130):
        clock.publish(Clock(clock=Time(sec=second)))
        ros.spin_until(lambda s=second: recorder.get_clock().now().nanoseconds == s * 10**9, 10.0)
        words.publish(String(data=f"{second}"))
        assert words.wait_for_all_acked(Duration(seconds=10))
        ros.spin_until(lambda s=second: sink.messages >= (3 if s == 100 else 5), 10.0)
    ros.executor.remove_node(recorder)
    recorder.destroy_node()
    sink.close()
    with BagReader(tmp_path / "bag") as bag:
        found = [(ns / 1e9, bag.decode(data, "std_msgs/msg/String").data) for _, ns, data in bag.messages(["/words"])]
        times = [bag.decode(data, "rosgraph_msgs/msg/Clock").clock.sec for _, _, data in bag.messages(["/clock"])]
    assert found == [(100.0, "before the first time"), (100.0, "100"), (130.0, "130")]
    assert times == [100, 130]


def test_where_the_middleware_does_not_tell_when_a_message_came_the_time_is_that_of_taking_it(ros: Ros) -> None:
    """CycloneDDS does not."""
    waiting, rows, told = [(b"word", {"received_timestamp": 0})], [], []
    sink = SimpleNamespace(put=lambda *row: rows.append(row))
    recorder = ros.node(lambda **options: BagRecorder(sink, ["none"], **options))
    handle = SimpleNamespace(take_message=lambda kind, raw: waiting.pop() if waiting else None)
    taken = SimpleNamespace(handle=handle, msg_type=String, callback=lambda data: told.append((data, len(rows))))
    recorder._heard["/words"] = TopicEar("std_msgs/msg/String", lambda profile: taken, 5)
    recorder._heard["/words"].follow([qos.RESULTS])
    begun_ns = time.time_ns()
    assert recorder.take() == 1
    ((name, stamp_ns, data),) = rows
    assert (name, data) == ("/words", b"word") and begun_ns <= stamp_ns <= time.time_ns()
    assert told == [(b"word", 1)], "who plays in step hears that it has been recorded"


def test_pictures_do_not_come_by_the_sockets_of_what_is_said_once(ros: Ros, tmp_path: Path) -> None:
    """Their buffer runs over when the recorder is held up: an order, which is not sent again, was lost with them."""
    talker = ros.plain("talker")
    kinds = {"/words": String, "/goals": PointStamped, "/eye": Image, "/cloud": PointCloud2}
    outputs = [talker.create_publisher(kind, name, qos.RESULTS) for name, kind in kinds.items()]
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0))
    ros.node(lambda **options: BagRecorder(sink, list(kinds), **options))
    ros.spin_until(lambda: all(output.get_subscription_count() for output in outputs), 40.0)

    def participant(topic: str) -> bytes:
        (reader,) = talker.get_subscriptions_info_by_topic(topic)
        return bytes(reader.endpoint_gid[:12])  # the rest names the reader in it

    assert participant("/words") == participant("/goals") != participant("/eye") == participant("/cloud")
    names = [name for name, _ in talker.get_node_names_and_namespaces() if not name.startswith("_")]
    assert names.count("bag_recorder") == 1, "people see one recorder"
    sink.close()


def test_it_is_said_that_it_records_once_what_is_there_is_recorded(ros: Ros, tmp_path: Path, command: Start) -> None:
    talker = ros.plain("talker")
    outputs = {f"/words_{i}": talker.create_publisher(String, f"words_{i}", WHOLE) for i in range(20)}
    program = command("bag_record", "-o", str(tmp_path / "bag"))
    assert program.process.stdout is not None
    assert any(line.startswith("recording to ") for line in program.process.stdout)
    for output in outputs.values():
        output.publish(String(data="now"))
    assert all(output.wait_for_all_acked(Duration(seconds=20)) for output in outputs.values())
    niceness = os.getpriority(os.PRIO_PROCESS, program.process.pid)
    program.end(signal.SIGINT)
    with BagReader(tmp_path / "bag") as bag:
        assert {t.name: t.count for t in bag.topics if t.name in outputs} == dict.fromkeys(outputs, 1)
    assert niceness > os.getpriority(os.PRIO_PROCESS, 0), "whoever is recorded comes first"


def test_a_recorder_of_named_topics_listens_once_it_hears_each(ros: Ros, tmp_path: Path) -> None:
    """A player in step starts then. One that was requested and found later had missed the messages before."""
    talker, sink = ros.plain("talker"), BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0))
    talker.create_publisher(String, "/words", WHOLE)
    recorder = ros.node(lambda **options: BagRecorder(sink, ["/words", "/late"], **options))
    ros.spin_until(lambda: recorder.missing == ["/late"], 40.0, lambda: recorder.missing)
    still_s = time.monotonic() + 1.5
    ros.spin_until(lambda: recorder.listens or time.monotonic() > still_s, 40.0)
    assert not recorder.listens
    talker.create_publisher(String, "/late", WHOLE)
    ros.spin_until(lambda: recorder.listens, 40.0, lambda: recorder.missing)
    assert recorder.recorded == {"/words", "/late"}
    sink.close()


def test_nothing_is_played_beside_a_driver_at_work(ros: Ros, tmp_path: Path, command: Start) -> None:
    with BagWriter(tmp_path / "bag", keep_free=0) as bag:
        bag.add_topic(BagTopic(name="/bed_1/gantry/driver_state", type="std_msgs/msg/String"))
        bag.add_topic(BagTopic(name="/bed_1/panel/alarm", type="std_msgs/msg/String", qos=(recorded_qos(WHOLE),)))
        for i in range(200):
            bag.write("/bed_1/panel/alarm", 10**9 + 50_000_000 * i, serialize_message(String(data=f"{i}")))
    other, driver = ros.plain("other"), ros.plain("driver")
    other.create_publisher(String, "/gantry/driver_state", qos.LATCHED)  # of another machine: it is none of ours
    heard = ros.collect(other, String, "/bed_1/panel/alarm", WHOLE)
    player = command("bag_play", str(tmp_path / "bag"))
    ros.spin_until(lambda: len(heard) > 5, 40.0, lambda: heard)
    driver.create_publisher(String, "/bed_1/gantry/driver_state", qos.LATCHED)
    output = player.end(code=1)
    assert "error: a driver is running here (/bed_1/gantry/driver_state)" in output
    count = len(heard)
    assert count < 200
    assert "a driver is running here" in command("bag_play", str(tmp_path / "bag"), "--wait", "60").end(code=1)
    assert len(heard) == count
    player = command("bag_play", str(tmp_path / "bag"), "--moving", "--rate", "10")
    ros.spin_until(lambda: len(heard) == count + 200, 40.0, lambda: len(heard))
    player.end()


def test_nothing_is_played_in_step_beside_a_driver_at_work(
    ros: Ros, tmp_path: Path, command: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = numbered_bag(tmp_path / "bag", ["/panel/alarm"], 3)
    driver = ros.plain("driver")
    driver.create_publisher(String, "/gantry/driver_state", qos.LATCHED)
    heard = ros.collect(driver, String, "/panel/alarm", qos.RESULTS)
    monkeypatch.setenv(LEDGER_VARIABLE, str(tmp_path / "steps"))
    with contextlib.closing(StepLedger(tmp_path / "steps")) as ledger:
        ledger.register()  # this process is the one that plays in step
        player = command("bag_play", str(bag), "--in-step", "1")
        ros.spin_until(lambda: player.process.poll() is not None, 40.0, lambda: heard)
        assert "error: a driver is running here (/gantry/driver_state)" in player.end(code=1)
        assert heard == []
        player = command("bag_play", str(bag), "--in-step", "1", "--moving")
        ros.spin_until(lambda: player.process.poll() is not None and len(heard) == 3, 40.0, lambda: heard)
        player.end()


@pytest.mark.parametrize(
    ("topic", "arguments", "state"),
    [
        ("/panel/alarm", ["--wait", "0"], "/gantry/driver_state"),
        ("/bed_1/panel/alarm", [], "/bed_1/gantry/driver_state"),
        (
            "/gantry/driver_state",
            ["--ros-args", "-r", "/gantry/driver_state:=/bed_2/gantry/driver_state"],
            "/bed_2/gantry/driver_state",
        ),
    ],
    ids=["without waiting for subscribers", "of a robot whose state was not recorded", "under another name"],
)
def test_a_driver_at_work_is_found_before_the_first_message(
    ros: Ros, tmp_path: Path, command: Start, topic: str, arguments: list[str], state: str
) -> None:
    bag = numbered_bag(tmp_path / "bag", [topic], 3)
    driver = ros.plain("driver")
    driver.create_publisher(String, state, qos.LATCHED)
    heard = ros.collect(driver, String, topic if topic.endswith("alarm") else state, qos.RESULTS)
    player = command("bag_play", str(bag), *arguments)
    ros.spin_until(lambda: player.process.poll() is not None, 40.0)
    assert f"error: a driver is running here ({state})" in player.end(code=1)
    assert heard == []


def test_a_recorded_clock_does_not_run_beside_that_of_the_player(ros: Ros, tmp_path: Path, command: Start) -> None:
    """It was recorded during another replay, and would throw the time to and fro."""
    with BagWriter(tmp_path / "bag", keep_free=0) as bag:
        bag.add_topic(BagTopic(name="/clock", type="rosgraph_msgs/msg/Clock"))
        bag.add_topic(BagTopic(name="/words", type="std_msgs/msg/String"))
        for i in range(20):
            bag.write("/clock", 10**9 + 10**7 * i, serialize_message(Clock(clock=Time(sec=77 + i))))
            bag.write("/words", 10**9 + 10**7 * i, serialize_message(String(data=f"{i}")))
    listener = ros.plain("listener")
    words = ros.collect(listener, String, "/words", QoSProfile(depth=100))
    times = ros.collect(listener, Clock, "/clock", QoSProfile(depth=100))
    output = command("bag_play", str(tmp_path / "bag"), "--clock", "100", "--wait", "60").end()
    assert "not played: /clock\n" in output
    ros.spin_until(lambda: len(words) == 20, 40.0, lambda: len(words))
    quiet(ros, times, 5)  # more than the words, some wait still
    assert times and all(message.clock.sec < 10 for message in times)
    words.clear()
    times.clear()
    command("bag_play", str(tmp_path / "bag"), "--wait", "60").end()
    ros.spin_until(lambda: len(words) == len(times) == 20, 40.0, lambda: (len(words), len(times)))
    assert [message.clock.sec for message in times] == [77 + i for i in range(20)]


def test_a_topic_of_a_type_that_is_not_installed_is_left_out_by_name(ros: Ros, tmp_path: Path, command: Start) -> None:
    """A bag may come from another computer; the other topics are played."""
    types = get_typestore(Stores.ROS2_JAZZY)
    types.register(get_types_from_msg("string text", "lab_msgs/msg/Note"))
    with BagWriter(tmp_path / "bag", keep_free=0, types=types) as bag:
        for name, kind in (("/note", "lab_msgs/msg/Note"), ("/words", "std_msgs/msg/String")):
            bag.add_topic(BagTopic(name=name, type=kind))
            for i in range(3):
                bag.write(name, 10**9 + i, serialize_message(String(data=f"{i}")))
    listener = ros.plain("listener")
    words = ros.collect(listener, String, "/words", qos.RESULTS)
    output = command("bag_play", str(tmp_path / "bag"), "--wait", "60").end(code=INCOMPLETE)
    loss = "missing: /note: 3 of 3 messages: not played: lab_msgs/msg/Note is not installed here\n"
    assert output.endswith(f"{loss}3 messages played\n")
    ros.spin_until(lambda: len(words) == 3, 40.0, lambda: len(words))
    asked = command("bag_play", str(tmp_path / "bag"), "--topics", "/note").process
    assert asked.communicate(timeout=40.0)[0] == "error: /note: lab_msgs/msg/Note is not installed here\n"
    assert asked.returncode == 1


def test_the_player_does_not_tell_more_than_it_has_played(ros: Ros, tmp_path: Path, command: Start) -> None:
    bag = numbered_bag(tmp_path / "bag", ["words"], 2)
    output = command("bag_play", str(bag), "--rate", "1000", "--wait", "0").end()
    # Each message takes longer than a thousandth of the 20 ms to the next.
    assert output.splitlines() == ["[..............................] 0.0 of 0.0 s, 1 messages", "2 messages played"]


def test_a_player_in_the_background_of_a_terminal_plays(ros: Ros, tmp_path: Path) -> None:
    """The kernel stops who sets up a terminal from its background, and nothing would be played."""
    bag = numbered_bag(tmp_path / "bag", ["words"], 3)
    output = output_in_background(
        *("icu_bringup.cli.bag_play", str(bag), "--wait", "0"),
        environment={"ROS_DOMAIN_ID": str(ros.context.get_domain_id()), "ROS_LOG_DIR": str(tmp_path / "log")},
    )
    assert output.splitlines()[-1:] == ["3 messages played"]


def test_a_player_that_still_waits_for_subscribers_is_not_paused_again(
    ros: Ros, tmp_path: Path, command: Start
) -> None:
    bag = numbered_bag(tmp_path / "bag", ["/a", "/b"], 4)
    listener = ros.plain("listener")
    a = ros.collect(listener, String, "/a", qos.RESULTS)
    player = command("bag_play", str(bag), "--start-paused", "--wait", "60")
    Toggle(ros, listener).until("playing")
    assert a == [], "nobody listens to /b"
    b = ros.collect(listener, String, "/b", qos.RESULTS)
    ros.spin_until(lambda: len(a) == len(b) == 4, 40.0, lambda: (len(a), len(b)))
    assert "8 messages played" in player.end()


def test_a_pause_at_the_end_of_a_loop_lasts(ros: Ros, tmp_path: Path, command: Start) -> None:
    bag = numbered_bag(tmp_path / "bag", ["/a"], 1)  # which ends again and again
    listener = ros.plain("listener")
    a = ros.collect(listener, String, "/a", qos.RESULTS)
    player = command("bag_play", str(bag), "--loop", "--wait", "60")
    ros.spin_until(lambda: len(a) > 100, 40.0, lambda: len(a))
    toggle = Toggle(ros, listener)
    toggle.until("paused")
    quiet(ros, a, 25)  # messages in transit have arrived
    a.clear()
    quiet(ros, a, 50)
    assert a == []
    toggle.until("playing")
    ros.spin_until(lambda: len(a) > 100, 40.0, lambda: len(a))
    player.end(signal.SIGINT)


def test_a_loop_with_nothing_to_play_listens_and_rests(ros: Ros, tmp_path: Path, command: Start) -> None:
    bag = numbered_bag(tmp_path / "bag", ["/gantry/goal"], 3)  # an order, which is not played
    player = command("bag_play", str(bag), "--loop", "--wait", "0")
    Toggle(ros, ros.plain("asker")).until("paused")
    before_s = processor_s(player)
    begun_s = time.monotonic()
    ros.spin_until(lambda: time.monotonic() > begun_s + 2.0, 5.0)
    assert processor_s(player) - before_s < 1.0
    assert "0 messages played" in player.end(signal.SIGINT)


def quiet(ros: Ros, received: Sequence[Any], turns: int) -> None:
    """Spin until nothing has arrived in this number of turns of 20 ms, in which this process waited and was not held
    up."""
    counts: list[int] = []
    ros.spin_until(lambda: (counts.append(len(received)), counts[-turns - 1 :].count(counts[-1]) > turns)[1], 60.0)


def processor_s(program: Command) -> float:
    fields = Path(f"/proc/{program.process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def test_recorded_pictures_come_back_as_pictures(ros: Ros, tmp_path: Path, command: Start) -> None:
    talker = ros.plain("talker")
    publisher = talker.create_publisher(Image, "eye/image_raw", qos.IMAGES)
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0), PictureCodec("png"))
    ros.node(lambda **options: BagRecorder(sink, ["eye/image_raw"], **options))
    ros.spin_until(publisher.get_subscription_count, 40.0)
    pixels = np.random.default_rng(5).integers(0, 256, (48, 64, 3), np.uint8)
    publisher.publish(image_message(pixels, "bgr8", header(77, "eye")))
    ros.spin_until(lambda: sink.messages == 1, 40.0, lambda: sink.failure)
    sink.close()
    with BagReader(tmp_path / "bag") as bag:
        assert [(t.name, t.type) for t in bag.topics] == [
            ("/eye/image_raw/compressed", "sensor_msgs/msg/CompressedImage")
        ]
    listener = ros.plain("listener")
    seen = ros.collect(listener, Image, "/again", qos.IMAGES)
    arguments = [str(tmp_path / "bag"), "--wait", "10", "--ros-args", "-r", "/eye/image_raw:=/again"]
    player = command("bag_play", *arguments)
    ros.spin_until(lambda: seen, 40.0)
    player.end()
    assert np.array_equal(image_array(seen[0]), pixels)
    assert (seen[0].header.stamp.nanosec, seen[0].header.frame_id, seen[0].encoding) == (77, "eye", "bgr8")


def test_a_recording_of_the_page_ends_whole_when_its_bridge_is_killed(ros: Ros, tmp_path: Path) -> None:
    """The restarted bridge knows nothing of it: it would continue, unseen, until the disk is full."""
    program = tmp_path / "bag_record"
    errors = tmp_path / "errors"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m icu_bringup.cli.bag_record "$@" 2> {errors}\n')
    program.chmod(0o755)
    bridge = (
        "import signal, sys; from pathlib import Path; from scope_ui_bridge.adapters.recorder import Recorder\n"
        "Recorder(sys.argv[1], Path(sys.argv[2])).start(lambda ok, text: print(text, flush=True)); signal.pause()"
    )
    environment = dict(os.environ, ROS_DOMAIN_ID=str(ros.context.get_domain_id()), ROS_LOG_DIR=str(tmp_path / "log"))
    with subprocess.Popen(
        [sys.executable, "-c", bridge, str(tmp_path / "sessions"), str(program)],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        folder = Path(process.stdout.readline().removeprefix("recording to ").strip())
        assert folder.parent == tmp_path / "sessions"
        process.kill()

        def whole() -> bool:  # which it is not yet while its description is being written
            with contextlib.suppress(BagError):
                BagReader(folder).close()
                return True
            return False

        ros.spin_until(whole, 40.0)
    assert "Traceback" not in errors.read_text()


def test_a_recorder_with_arguments_that_ros_cannot_read_makes_no_bag(ros: Ros, tmp_path: Path, command: Start) -> None:
    output = command("bag_record", "-o", str(tmp_path / "bag"), "--ros-args", "-r", "foo").end(code=2)
    assert "error: " in output and "remap rule: '-r foo'" in output and "Traceback" not in output
    assert not (tmp_path / "bag").exists()


def outlasting(bag: Path) -> int:
    """Return how many messages of a bag outlive its recorder."""
    with (
        contextlib.suppress(sqlite3.OperationalError),
        contextlib.closing(sqlite3.connect(f"file:{next(bag.glob('*.db3'))}?mode=ro", uri=True)) as data,
    ):
        return int(data.execute("select count(*) from messages").fetchone()[0])
    return 0


def test_the_recorder_as_a_program_keeps_the_bag_whole_when_it_is_killed(
    ros: Ros, tmp_path: Path, command: Start
) -> None:
    talker = ros.plain("talker")
    publisher = talker.create_publisher(String, "words", WHOLE)
    program = command("bag_record", "/words", "-o", str(tmp_path / "bag"), "-s", "sqlite3")
    ros.spin_until(publisher.get_subscription_count, 40.0)
    publisher.publish(String(data="first"))
    start_s, sent = time.monotonic(), 0
    # On and on where the recorder is held up, and so slowly that it misses none: it keeps fifty that wait.
    while time.monotonic() - start_s < 2.5 or outlasting(tmp_path / "bag") < sent / 2:
        assert time.monotonic() - start_s < 40.0, sent
        publisher.publish(String(data=f"{sent}"))
        sent += 1
        ros.executor.spin_once(timeout_sec=0.06)
    program.process.kill()
    program.process.communicate()
    saved = subprocess.run(
        [sys.executable, "-m", "icu_bringup.cli.bag_info", str(tmp_path / "bag"), "--repair", str(tmp_path / "new")],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    print(saved.stdout, sent)
    with BagReader(tmp_path / "new") as bag:
        words = [bag.decode(d, "std_msgs/msg/String").data for _, _, d in bag.messages()]
    assert words[0] == "first" and words[1:] == [f"{i}" for i in range(len(words) - 1)]
    assert len(words) > sent / 4, "at most about a second was lost"
