"""States, events and goals of a session as parquet files; each field's metadata has its unit and meaning."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.export.adapters.reading import decoded, kinds_of
from icu_bringup.export.core.session import RecordedSession

TEXT, EMPTY = "std_msgs/msg/String", "std_msgs/msg/Empty"
NUMBER, POINT = "std_msgs/msg/Float32", "geometry_msgs/msg/PointStamped"
ANSWERS = "diagnostic_msgs/msg/DiagnosticArray"
EVENTS = (TEXT, EMPTY, NUMBER, POINT, ANSWERS)


def write_tables(bag: BagReader, session: RecordedSession, folder: Path) -> dict[str, int]:
    """Write states.parquet, events.parquet and goals.parquet; return the rows of each."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    def field(name: str, kind: Any, unit: str, about: str) -> Any:
        return pa.field(name, kind, metadata={"unit": unit, "description": about})

    time = field("time_ns", pa.int64(), "ns", "reception, since 1970-01-01 UTC or in the recording's simulated time")
    joints = [field(n, pa.float64(), "m", "joint position; 0 is the home position") for n in session.joint_names]
    targets = [
        field(f"target_{n}", pa.float64(), "m", "commanded joint position at this time") for n in session.joint_names
    ]
    rows: dict[str, tuple[Any, list[dict[str, Any]]]] = {}
    states = []
    for time_ns, position in zip(session.times_ns, session.positions_m):
        target = session.target_at(time_ns)
        assert target is not None
        names = [*session.joint_names, *(f"target_{name}" for name in session.joint_names)]
        states.append({"time_ns": time_ns, **dict(zip(names, [*position.tolist(), *target.tolist()]))})
    rows["states"] = (pa.schema([time, *joints, *targets]), states)
    metres = "m; px where the frame is that of a camera and the topic ends with /goal"
    rows["events"] = (
        pa.schema(
            [
                time,
                field("topic", pa.string(), "", "topic"),
                field("type", pa.string(), "", "message type"),
                field("text", pa.string(), "", "String: its text; DiagnosticArray: the message of its status"),
                field("value", pa.float64(), "as the topic's", "Float32: its value"),
                *(field(axis, pa.float64(), metres, f"PointStamped: {axis}") for axis in "xyz"),
                field("frame", pa.string(), "", "PointStamped: frame"),
                field("values", pa.map_(pa.string(), pa.string()), "", "DiagnosticArray: keys and values of a status"),
            ]
        ),
        _events(bag),
    )
    rows["goals"] = (
        pa.schema(
            [
                field("goal_id", pa.string(), "", "id of goal and answers"),
                field("task", pa.string(), "", "command without its id, or the point in words"),
                field("sent_ns", pa.int64(), "ns", "reception of the goal"),
                field("accepted_ns", pa.int64(), "ns", "reception of the answer accepted"),
                field("ended_ns", pa.int64(), "ns", "reception of the final answer"),
                field("outcome", pa.string(), "", "reached, aborted, rejected or unanswered"),
                field("success", pa.bool_(), "", "whether the goal was reached; null: unanswered"),
                field("error_m", pa.float64(), "m", "measured distance between target and tip; null: not measured"),
                field("duration_s", pa.float64(), "s", "time since the goal was accepted; null: not accepted"),
                field("reason", pa.string(), "", "why it was rejected or aborted"),
                field("code", pa.string(), "", "machine-readable cause"),
            ]
        ),
        [_goal_row(goal) for goal in session.goals],
    )
    folder.mkdir(parents=True)
    for name, (schema, values) in rows.items():
        pq.write_table(pa.Table.from_pylist(values, schema=schema), folder / f"{name}.parquet")
    return {name: len(values) for name, (_, values) in rows.items()}


def _goal_row(goal: Any) -> dict[str, Any]:
    row = {"goal_id": goal.goal_id, "task": goal.task, "outcome": goal.outcome}
    row |= {"sent_ns": goal.sent_ns, "accepted_ns": goal.accepted_ns, "ended_ns": goal.ended_ns}
    if goal.result is not None:
        numbers = {"error_m": goal.result.error_m, "duration_s": goal.result.duration_s}
        row |= {key: value if math.isfinite(value) else None for key, value in numbers.items()}
        row |= {"success": goal.outcome == "reached", "reason": goal.result.reason, "code": goal.result.code}
    return row


def _events(bag: BagReader) -> list[dict[str, Any]]:
    kinds = {topic: kind for topic, kind in kinds_of(bag).items() if kind in EVENTS and topic != "/diagnostics"}
    rows = []
    for topic, time_ns, message in decoded(bag, set(kinds)):
        row: dict[str, Any] = {"time_ns": time_ns, "topic": topic, "type": kinds[topic]}
        match kinds[topic]:
            case "std_msgs/msg/String":
                row["text"] = message.data
            case "std_msgs/msg/Float32":
                row["value"] = float(message.data)
            case "geometry_msgs/msg/PointStamped":
                row |= {"x": message.point.x, "y": message.point.y, "z": message.point.z}
                row["frame"] = message.header.frame_id
            case "diagnostic_msgs/msg/DiagnosticArray":
                rows += [
                    row | {"text": status.message, "values": [(pair.key, pair.value) for pair in status.values]}
                    for status in message.status
                ]
                continue
        rows.append(row)
    return rows
