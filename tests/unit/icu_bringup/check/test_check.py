"""Comparison of a replay with an expectation: values of messages, tolerances, rows, and their files."""

from __future__ import annotations

import dataclasses
import math
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from icu_bringup.core.check import report
from icu_bringup.core.check.comparison import (
    ComparedMessage,
    Row,
    TopicMessages,
    compare,
    matched,
    new_topic,
    unknown_fields,
)
from icu_bringup.core.check.expectation import Expectation, Run, TopicExpectation, from_yaml, to_yaml
from icu_bringup.core.check.tolerances import Tolerance, difference, tolerance_for, tolerance_of
from icu_bringup.core.check.values import Kind, Value, stamp_ns, values_of

TYPES = get_typestore(Stores.ROS2_JAZZY).types


def message(kind: str, **values: Any) -> Any:
    return TYPES[kind](**values)


def header(stamp: int = 0, frame: str = "camera") -> Any:
    time = message("builtin_interfaces/msg/Time", sec=stamp // 1_000_000_000, nanosec=stamp % 1_000_000_000)
    return message("std_msgs/msg/Header", stamp=time, frame_id=frame)


def pose(x: float, turn: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0), stamp: int = 5) -> Any:
    point = message("geometry_msgs/msg/Point", x=x, y=2.0, z=3.0)
    rotation = message("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", turn)))
    inner = message("geometry_msgs/msg/Pose", position=point, orientation=rotation)
    return message("geometry_msgs/msg/PoseStamped", header=header(stamp), pose=inner)


def image(pixels: np.ndarray, encoding: str = "mono8", *, padding: int = 0) -> Any:
    rows = pixels.reshape(pixels.shape[0], -1).view(np.uint8)
    rows = np.hstack([rows, np.full((len(rows), padding), 7, np.uint8)])
    return message(
        "sensor_msgs/msg/Image",
        header=header(),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=rows.shape[1],
        data=rows.ravel(),
    )


def cloud(points: np.ndarray, names: str = "xyz") -> Any:
    fields = [
        message("sensor_msgs/msg/PointField", name=name, offset=4 * i, datatype=7, count=1)
        for i, name in enumerate(names)
    ]
    data = np.ascontiguousarray(points, np.float32)
    return message(
        "sensor_msgs/msg/PointCloud2",
        header=header(),
        height=1,
        width=len(data),
        fields=fields,
        is_bigendian=False,
        point_step=4 * len(names),
        row_step=4 * len(names) * len(data),
        data=data.view(np.uint8).ravel(),
        is_dense=True,
    )


def diagnostics(**values: str) -> Any:
    pairs = [message("diagnostic_msgs/msg/KeyValue", key=key, value=value) for key, value in values.items()]
    status = message(
        "diagnostic_msgs/msg/DiagnosticStatus", level=0, name="goal", message="", hardware_id="", values=pairs
    )
    return message("diagnostic_msgs/msg/DiagnosticArray", header=header(), status=[status])


def topic(*messages: Any) -> TopicMessages:
    kind = messages[0].__msgtype__
    return TopicMessages(type=kind, messages=tuple(ComparedMessage(stamp_ns(m), values_of(m)) for m in messages))


def numbers(*values: float) -> Value:
    return Value(Kind.NUMBER, np.array(values, np.float64))


def test_a_message_has_a_value_for_each_field_and_none_for_its_stamp() -> None:
    values = values_of(pose(1.0))
    assert set(values) == {
        *("header.frame_id", "pose.position.x", "pose.position.y", "pose.position.z", "pose.orientation"),
    }
    assert values["pose.position.y"].data.tolist() == [2.0]
    assert values["pose.orientation"].kind is Kind.ROTATION and values["header.frame_id"].text == "camera"
    assert stamp_ns(pose(1.0, stamp=7_000_000_003)) == 7_000_000_003


def test_values_of_diagnostics_have_their_keys_and_numbers_are_numbers() -> None:
    values = values_of(diagnostics(outcome="reached", error_m="0.00012", target_base_m="0.1 0.2 -0.01"))
    assert values["status[0].values.outcome"].text == "reached"
    assert values["status[0].values.error_m"].data.tolist() == [0.00012]
    assert values["status[0].values.target_base_m"].data.tolist() == [0.1, 0.2, -0.01]
    assert not [path for path in values if path.endswith(("OK", "WARN"))], "constants are no fields"


def test_the_points_of_a_marker_are_one_value_and_an_empty_texture_an_empty_image() -> None:
    points = [message("geometry_msgs/msg/Point", x=float(n), y=0.5, z=0.0) for n in range(3)]
    texture = message("sensor_msgs/msg/CompressedImage", header=header(), format="", data=np.zeros(0, np.uint8))
    assert values_of(texture)["data"].data.size == 0
    mesh = message("shape_msgs/msg/Mesh", triangles=[], vertices=points)
    assert values_of(mesh)["vertices"].data.tolist() == [0.0, 0.5, 0.0, 1.0, 0.5, 0.0, 2.0, 0.5, 0.0]


@pytest.mark.parametrize(("encoding", "shape"), [("mono8", (4, 6)), ("bgr8", (4, 6, 3))])
def test_an_image_is_read_without_the_padding_of_its_rows(encoding: str, shape: tuple[int, ...]) -> None:
    pixels = np.arange(math.prod(shape), dtype=np.uint8).reshape(shape)
    assert np.array_equal(values_of(image(pixels, encoding, padding=5))["data"].data, pixels)


def test_a_float_image_and_one_of_16_bits_are_read_as_such() -> None:
    depths = np.array([[0.5, math.inf], [1.5, -2.0]], np.float32)
    assert np.array_equal(values_of(image(depths, "32FC1"))["data"].data, depths)
    counts = np.array([[1, 60000]], np.uint16)
    assert np.array_equal(values_of(image(counts, "mono16"))["data"].data, counts)


def test_a_cloud_is_compared_by_its_nearest_points_whatever_their_order() -> None:
    points = np.random.default_rng(3).uniform(-1, 1, (300, 3))
    old = values_of(cloud(points))["points"]
    assert old.text == "x y z"
    turned = values_of(cloud(points[::-1]))["points"]
    assert difference(old, turned, Tolerance()).amounts == {"distance": pytest.approx(0.0, abs=1e-6), "count": 0.0}
    moved = values_of(cloud(points + [0.002, 0.0, 0.0]))["points"]
    assert difference(old, moved, Tolerance()).amounts["distance"] == pytest.approx(0.002, rel=0.01)
    fewer = values_of(cloud(points[:270]))["points"]
    assert difference(old, fewer, Tolerance()).amounts["count"] == pytest.approx(0.1)
    assert math.isinf(difference(old, values_of(cloud(points, "abc"))["points"], Tolerance()).amounts["distance"])


def test_corners_are_compared_in_pixels_by_u_and_v_alone() -> None:
    points = np.random.default_rng(4).uniform(0, 500, (100, 3))
    other = points.copy()
    other[:, 2] *= 2  # the response
    both = [values_of(cloud(p, "uvr"))["points"] for p in (points, other)]
    assert difference(*both, Tolerance()).amounts["distance"] == pytest.approx(0.0, abs=1e-3)
    assert tolerance_for("points", both[0], {}, 2).limits["distance"] == 0.05


@pytest.mark.parametrize(
    ("old", "new", "limits", "exceeds"),
    [
        ((1.0,), (1.0,), {}, False),
        ((1.0,), (1.1,), {"absolute": 0.11}, False),
        ((1.0,), (1.1,), {"absolute": 0.09}, True),
        ((100.0,), (101.0,), {"relative": 0.011}, False),
        ((100.0,), (101.0,), {"relative": 0.009}, True),
        ((100.0,), (101.0,), {"relative": 0.009, "absolute": 0.2}, False),
        ((math.nan,), (math.nan,), {}, False),
        ((math.nan,), (1.0,), {"absolute": 1e9}, True),
        ((math.inf,), (math.inf,), {}, False),
        ((1.0, 2.0), (1.0,), {"absolute": 1e9}, True),
    ],
)
def test_numbers(old: tuple[float, ...], new: tuple[float, ...], limits: dict[str, float], exceeds: bool) -> None:
    tolerance = Tolerance(limits=limits)
    assert difference(numbers(*old), numbers(*new), tolerance).exceeds(tolerance) is exceeds


def test_a_rotation_is_an_angle_and_the_opposite_quaternion_the_same_one() -> None:
    half = math.radians(0.02) / 2
    old, new = values_of(pose(1.0))["pose.orientation"], values_of(pose(1.0, (math.sin(half), 0, 0, math.cos(half))))
    turned = new["pose.orientation"]
    assert difference(old, turned, Tolerance()).amounts["angle_deg"] == pytest.approx(0.02, rel=1e-6)
    opposite = dataclasses.replace(turned, data=-turned.data)
    assert difference(old, opposite, Tolerance()).amounts["angle_deg"] == pytest.approx(0.02, rel=1e-6)
    upside_down = values_of(pose(1.0, (1.0, 0.0, 0.0, 0.0)))["pose.orientation"]
    assert difference(old, upside_down, Tolerance()).amounts["angle_deg"] == pytest.approx(180.0)


def test_an_image_is_compared_by_the_mean_of_its_differences() -> None:
    old = np.full((10, 10), 100, np.uint8)
    new = old.copy()
    new[0] = 130
    a, b = (values_of(image(p))["data"] for p in (old, new))
    assert difference(a, b, Tolerance()).amounts == {"mean": 3.0}
    assert math.isinf(difference(a, values_of(image(old[:5]))["data"], Tolerance()).amounts["mean"])


def test_messages_are_matched_by_stamp_and_without_stamps_by_place() -> None:
    old, new = topic(pose(1, stamp=1), pose(2, stamp=2)), topic(pose(2, stamp=2), pose(3, stamp=3))
    pairs = matched(old.messages, new.messages)
    assert [after and after.stamp_ns for _, after in pairs] == [None, 2]
    unstamped = [ComparedMessage(0, {"data": numbers(v)}) for v in range(6)]
    pairs = matched(unstamped[::3], unstamped, every=3)
    assert [after.values["data"].data[0] if after else None for _, after in pairs] == [0.0, 3.0]


def expectation(**topics: TopicExpectation) -> Expectation:
    return Expectation(bag="bag", messages="m", topics={f"/{name}": value for name, value in topics.items()})


def rows_of(expected: TopicMessages, found: TopicMessages, **fields: Tolerance) -> dict[str, Row]:
    paths = {path.replace("__", "."): tolerance for path, tolerance in fields.items()}
    wanted = TopicExpectation(type=expected.type, messages=len(expected.messages), fields=paths)
    return {r.field: r for r in compare(expectation(a=wanted), {"/a": expected}, {"/a": found})}


def test_a_field_is_judged_by_its_worst_message() -> None:
    old = topic(*(pose(0.0, stamp=n) for n in (1, 2, 3)))
    new = topic(pose(0.0, stamp=1), pose(0.005, stamp=2), pose(0.002, stamp=3))
    row = rows_of(old, new, pose__position__x=Tolerance(limits={"absolute": 0.001}))["pose.position.x"]
    assert (row.compared, row.differing, row.at, row.amount) == (3, 2, 2, pytest.approx(0.005))
    assert (row.expected, row.found, row.passed) == ("0", "0.005", False)
    ignored = rows_of(old, new, pose__position__x=Tolerance(ignored=True))
    assert "pose.position.x" not in ignored and all(r.passed for r in ignored.values())


def test_missing_additional_and_other_messages_differ() -> None:
    old = topic(pose(0.0, stamp=1), pose(0.0, stamp=2))
    rows = rows_of(old, topic(pose(0.0, stamp=1)))
    assert not rows["messages"].passed and rows["messages"].found == "1" and not rows["stamps"].passed
    rows = rows_of(old, topic(*(pose(0.0, stamp=n) for n in (1, 2, 3))))
    assert not rows["messages"].passed and "stamps" not in rows
    rows = rows_of(old, topic(diagnostics(a="1")))
    assert not rows["type"].passed and rows["type"].found == "diagnostic_msgs/msg/DiagnosticArray"
    nothing = compare(expectation(a=TopicExpectation(type=old.type, messages=2)), {"/a": old}, {})
    assert not nothing[0].passed and nothing[0].found == "0"


def test_a_field_that_only_one_side_has_differs() -> None:
    old, new = topic(diagnostics(a="1")), topic(diagnostics(b="1"))
    rows = rows_of(old, new)
    assert rows["status[0].values.a"].found == "absent" and rows["status[0].values.b"].expected == "absent"
    assert not rows["status[0].values.a"].passed and not rows["status[0].values.b"].passed


def test_a_tolerance_of_all_indices_and_of_one() -> None:
    old, new = topic(diagnostics(error_m="0.001")), topic(diagnostics(error_m="0.003"))
    wide, narrow = Tolerance(limits={"absolute": 0.01}), Tolerance(limits={"absolute": 0.001})
    wanted = TopicExpectation(type=old.type, messages=1, fields={"status[*].values.error_m": wide})
    assert all(r.passed for r in compare(expectation(a=wanted), {"/a": old}, {"/a": new}))
    fields = {**wanted.fields, "status[0].values.error_m": narrow}
    rows = compare(expectation(a=dataclasses.replace(wanted, fields=fields)), {"/a": old}, {"/a": new})
    assert [r.field for r in rows if not r.passed] == ["status[0].values.error_m"]


def test_an_unknown_field_in_an_expectation_is_named() -> None:
    old = topic(pose(0.0))
    wanted = TopicExpectation(type=old.type, messages=1, fields={"pose.positon.x": Tolerance()})
    assert unknown_fields(expectation(a=wanted), {"/a": old}) == ["/a: pose.positon.x"]


def test_new_tolerances_follow_from_what_repeated_runs_differ_by() -> None:
    runs = [topic(pose(0.0, stamp=1), pose(x, stamp=2)) for x in (0.0, 0.01, -0.02)]
    made = new_topic(runs)
    assert made.messages == 2 and made.missing == 0
    limit = made.fields["pose.position.x"]
    assert limit.limits == {"absolute": pytest.approx(0.06)} and "3 runs (0.02)" in limit.why
    assert made.fields["pose.position.y"].limits == {"absolute": 1e-4}
    assert made.fields["header.frame_id"].limits == {} and "the same in 3 runs" in made.fields["header.frame_id"].why
    kept = dataclasses.replace(made, fields={"pose.position.x": Tolerance(limits={"absolute": 1.0}, why="by hand")})
    assert new_topic(runs, old=kept).fields["pose.position.x"].why == "by hand"
    texts = [topic(diagnostics(id=name)) for name in ("a", "b")]
    assert new_topic(texts).fields["status[*].values.id"].ignored


@pytest.mark.parametrize(
    ("name", "limit"),
    [("error_m", 1e-4), ("offset_mm", 0.1), ("angle_deg", 0.05), ("shift_px", 0.05), ("wait_s", 1e-3)],
)
def test_the_least_tolerance_of_a_number_has_the_unit_in_its_name(name: str, limit: float) -> None:
    """The position of a knob is near 0 degrees: a part of it would be less than rounding."""
    made = new_topic([topic(diagnostics(**{name: "0.0125"})) for _ in range(2)])
    assert made.fields[f"status[*].values.{name}"].limits == {"absolute": limit}


def test_an_expectation_is_the_same_after_writing_and_reading() -> None:
    wanted = Expectation(
        bag="session",
        messages="session_messages",
        run=Run(nodes=("corners_left",), settings=("corners_left.k=0.04",), moving=True, duration_s=2.5),
        topics={
            "/a": TopicExpectation(
                type="std_msgs/msg/String",
                messages=3,
                missing=1,
                every=12,
                fields={"data": Tolerance(ignored=True, why="ids"), "x[*].y": Tolerance(limits={"absolute": 1e-7})},
            )
        },
    )
    assert from_yaml(to_yaml(wanted)) == wanted


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[", "line 1"),
        ("version: 2", "version 1"),
        ("{version: 1, messages: m, extra: 1}", "unknown extra"),
        ("{version: 1, topics: {}}", "messages: a text is expected"),
        ("{version: 1, messages: m, run: {moving: 1}}", "run.moving: bool is expected, got 1"),
        ("{version: 1, messages: m, run: {nodes: corners}}", "run.nodes: a list of texts is expected"),
        ("{version: 1, messages: m, topics: {/a: {type: t, messages: -1}}}", "/a: messages: a number of at least 0"),
        (
            "{version: 1, messages: m, topics: {/a: {type: t, fields: {x: {absolut: 1}}}}}",
            "/a: x: unknown limit 'absolut'",
        ),
        ("{version: 1, messages: m, topics: {/a: {type: t, fields: {x: {absolute: -1}}}}}", "no number of at least 0"),
        ("{version: 1, messages: m, topics: {/a: {type: t, every: 0}}}", "every: 0 is below 1"),
    ],
)
def test_a_broken_expectation_says_where_and_why(text: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason.replace("(", r"\(")):
        from_yaml(text)


def test_a_tolerance_reads_only_known_limits() -> None:
    assert tolerance_of({"absolute": 1, "why": "w"}) == Tolerance(limits={"absolute": 1.0}, why="w")
    with pytest.raises(ValueError, match="True is no number"):
        tolerance_of({"relative": True})


def row(**changed: Any) -> Row:
    values = {"compared": 4, "differing": 1, "amount": 0.005, "at": 2, "expected": "0", "found": "a|b"}
    return Row(**{"topic": "/panel/pose", "field": "x", "limits": "absolute 0.001", **values, **changed})


def test_a_report_names_what_differs_in_each_form() -> None:
    rows = [row(), row(field="y", differing=0, amount=0.0), row(field="z", amount=math.inf, found="absent")]
    assert report.verdict("bag", rows) == "bag: 2 of 3 fields differ (/panel/pose)"
    assert "0.005" in report.table(rows).splitlines()[1] and "different" in report.table(rows).splitlines()[3]
    text = report.markdown("bag", rows, ["p.png"])
    assert "| /panel/pose | x | 0 | a\\|b | 0.005 | absolute 0.001 |" in text and "![p.png](p.png)" in text
    assert "| /panel/pose | 1 of 3 |" in text
    suite = ElementTree.fromstring(report.junit("bag", rows, 1.5)).find("testsuite")
    assert suite is not None and (suite.get("tests"), suite.get("failures")) == ("3", "2")
    assert [case.get("name") for case in suite if case.find("failure") is not None] == ["x", "z"]
    assert [r["amount"] for r in report.as_json(rows)] == [0.005, 0.0, None]
    assert report.verdict("bag", rows[1:2]) == "bag: as expected (1 fields, 1 topics)"


def test_a_check_that_could_not_run_is_an_error_for_junit() -> None:
    suite = ElementTree.fromstring(report.junit_error("bag", "no <messages>")).find("testsuite")
    assert suite is not None and suite.get("errors") == "1"
    error = suite.find("testcase/error")
    assert error is not None and error.get("message") == "no <messages>"
