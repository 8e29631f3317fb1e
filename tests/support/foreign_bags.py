"""Small bags in the forms of Humble (sqlite3, MCAP) and Jazzy (sqlite3, MCAP), written without this project's code."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

TYPES = get_typestore(Stores.ROS2_JAZZY)
STRING = "std_msgs/msg/String"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
FORMS = [("humble", "sqlite3"), ("humble", "mcap"), ("jazzy", "sqlite3"), ("jazzy", "mcap")]
Row = tuple[str, int, bytes]


def text(value: str) -> bytes:
    """Return a std_msgs/String."""
    return bytes(TYPES.serialize_cdr(TYPES.types[STRING](data=value), STRING))


def profile(release: str, **changed: Any) -> dict[str, Any]:
    """Return a QoS profile in the form of a release: Humble has numbers, Jazzy names."""
    values = {"history": 3, "depth": 0, "reliability": 1, "durability": 2, "liveliness": 1}
    names = {
        "history": {1: "keep_last", 3: "unknown"},
        "reliability": {1: "reliable", 2: "best_effort"},
        "durability": {1: "transient_local", 2: "volatile"},
        "liveliness": {1: "automatic"},
    }
    times = {
        name: {"sec": 9223372036, "nsec": 854775807} for name in ("deadline", "lifespan", "liveliness_lease_duration")
    }
    mine = {**values, **changed}
    if release == "jazzy":
        mine = {name: names.get(name, {}).get(value, value) for name, value in mine.items()}
    return {**mine, **times, "avoid_ros_namespace_conventions": False}


def bag(
    folder: Path,
    form: tuple[str, str],
    rows: Sequence[Row],
    *,
    kinds: Mapping[str, str] | None = None,
    definitions: Mapping[str, str] | None = None,
    file_qos: Mapping[str, dict[str, Any]] | None = None,
    metadata_qos: Mapping[str, dict[str, Any]] | None = None,
    starting_ns: int | None = None,
) -> Path:
    """Write a bag.

    Parameters
    ----------
    folder, form, rows
        Path of the bag; release and storage; (topic, time in ns, CDR) of each message.
    kinds
        Type of each topic; the default is std_msgs/String.
    definitions
        Text of each type; only a Humble bag in sqlite3 has none.
    file_qos, metadata_qos
        Changed values of each topic's profiles, in the file and in metadata.yaml.
    starting_ns
        Starting time in metadata.yaml; None: the time of the first message.
    """
    release, storage = form
    folder.mkdir()
    names = sorted({row[0] for row in rows} | set(kinds or ()))
    types = {name: (kinds or {}).get(name, STRING) for name in names}
    texts = {STRING: "string data\n", **(definitions or {})}
    hashes = {STRING: STRING_HASH} if release == "jazzy" else {}
    profiles = {name: [profile(release, **(file_qos or {}).get(name, {}))] for name in names}
    file = folder / f"{folder.name}_0.{'db3' if storage == 'sqlite3' else 'mcap'}"
    if storage == "sqlite3":
        _sqlite(file, release, rows, types, texts, hashes, profiles)
    else:
        _mcap(file, rows, types, texts, profiles)
    told = {name: [profile(release, **(metadata_qos or file_qos or {}).get(name, {}))] for name in names}
    _metadata(folder, form, file, rows, types, hashes, told, starting_ns)
    return folder


def _sqlite(
    file: Path,
    release: str,
    rows: Sequence[Row],
    types: Mapping[str, str],
    texts: Mapping[str, str],
    hashes: Mapping[str, str],
    profiles: Mapping[str, Any],
) -> None:
    database = sqlite3.connect(file)
    jazzy = release == "jazzy"
    database.executescript(
        "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY,ros_distro TEXT NOT NULL);"
        "CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,serialization_format TEXT NOT"
        f" NULL,offered_qos_profiles TEXT NOT NULL{',type_description_hash TEXT NOT NULL' if jazzy else ''});"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,timestamp INTEGER NOT NULL,data BLOB"
        " NOT NULL);CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
        f"INSERT INTO schema VALUES({4 if jazzy else 3},'{release}');"
    )
    ids = {}
    for name, kind in types.items():
        values = [name, kind, "cdr", yaml.safe_dump(profiles[name])] + ([hashes.get(kind, "")] if jazzy else [])
        marks = ",".join("?" * len(values))
        ids[name] = database.execute(f"INSERT INTO topics VALUES(NULL,{marks})", values).lastrowid
    if jazzy:
        database.execute(
            "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY,topic_type TEXT NOT NULL,encoding TEXT NOT NULL,"
            "encoded_message_definition TEXT NOT NULL,type_description_hash TEXT NOT NULL)"
        )
        for kind in set(types.values()) & set(texts):
            row = (kind, "ros2msg", texts[kind], hashes.get(kind, ""))
            database.execute("INSERT INTO message_definitions VALUES(NULL,?,?,?,?)", row)
    database.executemany(
        "INSERT INTO messages VALUES(NULL,?,?,?)", [(ids[name], stamp_ns, data) for name, stamp_ns, data in rows]
    )
    database.commit()
    database.close()


def _mcap(
    file: Path,
    rows: Sequence[Row],
    types: Mapping[str, str],
    texts: Mapping[str, str],
    profiles: Mapping[str, Any],
) -> None:
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        schemas = {
            kind: writer.register_schema(kind, "ros2msg", texts.get(kind, "").encode()) for kind in set(types.values())
        }
        channels = {
            name: writer.register_channel(
                name, "cdr", schemas[kind], {"offered_qos_profiles": yaml.safe_dump(profiles[name])}
            )
            for name, kind in types.items()
        }
        for name, stamp_ns, data in rows:
            writer.add_message(channels[name], stamp_ns, data, stamp_ns)
        writer.finish()


def _metadata(
    folder: Path,
    form: tuple[str, str],
    file: Path,
    rows: Sequence[Row],
    types: Mapping[str, str],
    hashes: Mapping[str, str],
    profiles: Mapping[str, Any],
    starting_ns: int | None,
) -> None:
    release, storage = form
    jazzy = release == "jazzy"
    times = [row[1] for row in rows] or [0]
    first = min(times) if starting_ns is None else starting_ns
    span = {
        "starting_time": {"nanoseconds_since_epoch": first},
        "duration": {"nanoseconds": max(times) - first},
        "message_count": len(rows),
    }
    topics = [
        {
            "topic_metadata": {
                "name": name,
                "type": kind,
                "serialization_format": "cdr",
                "offered_qos_profiles": profiles[name] if jazzy else yaml.safe_dump(profiles[name]),
                **({"type_description_hash": hashes.get(kind, "")} if jazzy else {}),
            },
            "message_count": sum(row[0] == name for row in rows),
        }
        for name, kind in types.items()
    ]
    info = {
        "version": 9 if jazzy else 5,
        "storage_identifier": storage,
        **span,
        "topics_with_message_count": topics,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [file.name],
        "files": [{"path": file.name, **span}],
        **({"custom_data": None, "ros_distro": release} if jazzy else {}),
    }
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": info}), encoding="utf-8")
