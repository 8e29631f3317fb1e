"""Bags against other implementations: the official MCAP reader, sqlite itself, and files in the form of Jazzy."""

from __future__ import annotations

import contextlib
import os
import random
import resource
import shutil
import signal
import sqlite3
import stat
import subprocess
import sys
import threading
import time
import zlib
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import CRCValidationError, StreamReader
from mcap.writer import CompressionType
from mcap.writer import Writer as OfficialWriter
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from icu_bringup.adapters.bag.bag_pictures import COMPRESSED, IMAGE, SUFFIX, PictureCodec
from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bag_repair import repair
from icu_bringup.adapters.bag.bag_sink import BagSink
from icu_bringup.adapters.bag.bag_writer import BagWriter
from icu_bringup.adapters.bag.bags import BagError, BagTopic
from icu_bringup.cli import bag_info
from icu_bringup.core.bag.mcap_records import MAGIC, whole_messages
from icu_bringup.core.bag.play_clock import PlayClock, progress_bar

pytestmark = pytest.mark.long

TYPES = get_typestore(Stores.ROS2_JAZZY)
STRING = "std_msgs/msg/String"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
ENDLESS = QosTime(9223372036, 854775807)
LATCHED = Qos(
    QosHistory.KEEP_LAST,
    1,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    ENDLESS,
    ENDLESS,
    QosLiveliness.AUTOMATIC,
    ENDLESS,
    False,
)
both = pytest.mark.parametrize("storage", ["mcap", "sqlite3"])


def text(value: str) -> bytes:
    return bytes(TYPES.serialize_cdr(TYPES.types[STRING](data=value), STRING))


def write(path: Path, storage: str, count: int = 20) -> list[tuple[str, int, bytes]]:
    rows = [("/a" if i % 3 else "/b", 1_700_000_000_000_000_000 + i * 10_000_000, text(f"{i}")) for i in range(count)]
    with BagWriter(path, storage, keep_free=0) as bag:
        bag.add_topic(BagTopic(name="/a", type=STRING, qos=(LATCHED,)))
        bag.add_topic(BagTopic(name="/b", type=STRING))
        for row in rows:
            bag.write(*row)
    return rows


def storage_file(path: Path) -> Path:
    return next(p for p in path.iterdir() if p.suffix in (".mcap", ".db3"))


@both
def test_what_is_written_is_read(tmp_path: Path, storage: str) -> None:
    rows = write(tmp_path / "bag", storage)
    with BagReader(tmp_path / "bag") as bag:
        assert list(bag.messages()) == rows
        assert list(bag.messages(["/b"], rows[10][1])) == [r for r in rows[10:] if r[0] == "/b"]
        assert [(t.name, t.type, t.count) for t in bag.topics] == [("/a", STRING, 13), ("/b", STRING, 7)]
        assert bag.topics[0].qos == (LATCHED,)
        assert (bag.start_ns, bag.duration_ns, bag.count) == (rows[0][1], 190_000_000, 20)


@both
@pytest.mark.parametrize("name", ["a#b", "100% of it", "50%20b", "why?", "r\xf6ntgen", "r\udcf6ntgen"])
def test_a_bag_may_have_any_name(tmp_path: Path, storage: str, name: str) -> None:
    """Also one that a locale without UTF-8 does not know: it comes as single bytes."""
    folder = tmp_path / name
    rows = write(folder / name, storage)
    for path in (folder / name, *(folder / name).glob("*.[md]*")):
        if path.name != "metadata.yaml":
            with BagReader(path) as bag:
                assert list(bag.messages()) == rows
    assert repair(folder / name, tmp_path / "new" / name) == (len(rows), "")
    with BagReader(tmp_path / "new" / name) as bag:
        assert bag.check() == len(rows)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([name, "new"]), "nothing is written elsewhere"


@both
def test_metadata_is_what_rosbag2_of_jazzy_decodes(tmp_path: Path, storage: str) -> None:
    """The keys that rosbag2_storage/yaml.hpp of Jazzy reads without a default, with the values that it understands."""
    write(tmp_path / "bag", storage)
    info = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert (info["version"], info["storage_identifier"]) == (9, storage)
    assert info["relative_file_paths"] == [storage_file(tmp_path / "bag").name]
    assert info["duration"] == {"nanoseconds": 190_000_000}
    assert info["starting_time"] == {"nanoseconds_since_epoch": 1_700_000_000_000_000_000}
    assert info["message_count"] == 20 and info["compression_format"] == info["compression_mode"] == ""
    assert [f["message_count"] for f in info["files"]] == [20]
    first = info["topics_with_message_count"][0]
    assert first["message_count"] == 13
    topic = first["topic_metadata"]
    assert (topic["name"], topic["type"], topic["serialization_format"]) == ("/a", STRING, "cdr")
    assert topic["type_description_hash"] == STRING_HASH
    assert topic["offered_qos_profiles"] == [
        {
            "history": "keep_last",
            "depth": 1,
            "reliability": "reliable",
            "durability": "transient_local",
            "deadline": {"sec": 9223372036, "nsec": 854775807},
            "lifespan": {"sec": 9223372036, "nsec": 854775807},
            "liveliness": "automatic",
            "liveliness_lease_duration": {"sec": 9223372036, "nsec": 854775807},
            "avoid_ros_namespace_conventions": False,
        }
    ]


def test_the_official_reader_reads_our_mcap(tmp_path: Path) -> None:
    rows = write(tmp_path / "bag", "mcap")
    with storage_file(tmp_path / "bag").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        seen = [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()]
        summary = reader.get_summary()
        header = reader.get_header()
    assert seen == rows
    assert header.profile == "ros2" and summary is not None and summary.statistics is not None
    assert summary.statistics.message_count == 20
    schema = next(iter(summary.schemas.values()))
    assert (schema.name, schema.encoding, schema.data.decode().splitlines()[0]) == (STRING, "ros2msg", "string data")


def test_our_sqlite_has_the_tables_of_jazzy(tmp_path: Path) -> None:
    rows = write(tmp_path / "bag", "sqlite3")
    database = sqlite3.connect(storage_file(tmp_path / "bag"))
    query = "SELECT name, timestamp, data FROM messages JOIN topics ON topics.id = topic_id ORDER BY timestamp"
    assert database.execute(query).fetchall() == rows
    assert database.execute("SELECT schema_version FROM schema").fetchone() == (4,)
    assert database.execute("SELECT DISTINCT type_description_hash FROM topics").fetchall() == [(STRING_HASH,)]
    database.close()


def jazzy_bag(folder: Path) -> list[tuple[str, int, bytes]]:
    """Write a bag as `ros2 bag record -s sqlite3` of Jazzy does: its tables, its metadata, two files."""
    folder.mkdir()
    rows = [("/chatter", 1_720_000_000_000_000_000 + i, text(f"hello {i}")) for i in range(6)]
    for number, part in enumerate((rows[:4], rows[4:])):
        database = sqlite3.connect(folder / f"talk_{number}.db3")
        database.executescript(
            "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY,ros_distro TEXT NOT NULL);"
            "CREATE TABLE metadata(id INTEGER PRIMARY KEY,metadata_version INTEGER NOT NULL,metadata TEXT NOT NULL);"
            "CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,serialization_format TEXT"
            " NOT NULL,offered_qos_profiles TEXT NOT NULL,type_description_hash TEXT NOT NULL);"
            "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY,topic_type TEXT NOT NULL,encoding TEXT NOT NULL,"
            "encoded_message_definition TEXT NOT NULL,type_description_hash TEXT NOT NULL);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,timestamp INTEGER NOT NULL,data"
            " BLOB NOT NULL);CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
            "INSERT INTO schema VALUES(4,'jazzy');"
        )
        qos = "- history: unknown\n  depth: 0\n  reliability: reliable\n  durability: volatile\n" + "".join(
            f"  {name}:\n    sec: 9223372036\n    nsec: 854775807\n"
            for name in ("deadline", "lifespan", "liveliness_lease_duration")
        )
        qos += "  liveliness: automatic\n  avoid_ros_namespace_conventions: false\n"
        database.execute("INSERT INTO topics VALUES(1,'/chatter',?,'cdr',?,?)", (STRING, qos, STRING_HASH))
        database.execute(
            "INSERT INTO message_definitions VALUES(1,?,'ros2msg','string data\n',?)", (STRING, STRING_HASH)
        )
        database.executemany("INSERT INTO messages(topic_id,timestamp,data) VALUES(1,?,?)", [r[1:] for r in part])
        database.commit()
        database.close()
    files = [
        {
            "path": f"talk_{number}.db3",
            "starting_time": {"nanoseconds_since_epoch": part[0][1]},
            "duration": {"nanoseconds": part[-1][1] - part[0][1]},
            "message_count": len(part),
        }
        for number, part in enumerate((rows[:4], rows[4:]))
    ]
    topic = {
        "name": "/chatter",
        "type": STRING,
        "serialization_format": "cdr",
        "offered_qos_profiles": yaml.safe_load(qos),
        "type_description_hash": STRING_HASH,
    }
    info = {
        "version": 9,
        "storage_identifier": "sqlite3",
        "duration": {"nanoseconds": 5},
        "starting_time": {"nanoseconds_since_epoch": rows[0][1]},
        "message_count": 6,
        "topics_with_message_count": [{"topic_metadata": topic, "message_count": 6}],
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": [f["path"] for f in files],
        "files": files,
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": info}))
    return rows


def test_a_bag_of_jazzy_in_two_files_is_read(tmp_path: Path) -> None:
    rows = jazzy_bag(tmp_path / "talk")
    with BagReader(tmp_path / "talk") as bag:
        assert list(bag.messages()) == rows
        assert bag.decode(rows[2][2], STRING).data == "hello 2"
        assert bag.topics[0].qos[0].history is QosHistory.UNKNOWN


@both
def test_a_bag_that_was_cut_off_is_refused_with_advice_and_repaired(
    tmp_path: Path, storage: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = write(tmp_path / "bag", storage, 3000)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    if storage == "mcap":
        file = storage_file(tmp_path / "bag")
        # The summary and the end of the only chunk are gone.
        file.write_bytes(file.read_bytes()[:-400])
    assert bag_info.main([str(tmp_path / "bag")]) == 1
    message = capsys.readouterr().err
    assert "cut off" in message and "--repair NEW_BAG" in message
    assert bag_info.main([str(tmp_path / "bag"), "--repair", str(tmp_path / "new")]) == 0
    print(capsys.readouterr().out)
    with BagReader(tmp_path / "new") as bag:
        assert list(bag.messages()) == rows
        assert bag.topics[0].qos == (LATCHED,)


def test_a_reader_that_has_seen_enough_ends_the_description_without_complaint(tmp_path: Path) -> None:
    write(tmp_path / "bag", "mcap")
    command = [sys.executable, "-m", "icu_bringup.cli.bag_info", str(tmp_path / "bag")]
    program = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert program.stdout is not None and program.stderr is not None
    program.stdout.close()
    with program.stderr:
        assert (program.stderr.read(), program.wait(30)) == ("", 0)


@pytest.mark.parametrize("name", ["notes.txt", "empty folder", "bag.yaml", "missing"])
def test_what_is_no_bag_is_not_to_be_repaired(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / name
    if name == "empty folder":
        path.mkdir()
    elif name != "missing":
        path.write_text("rosbag2_bagfile_information: {}\n")
    for more in ([], ["--repair", str(tmp_path / "new")]):
        assert bag_info.main([str(path), *more]) == 1
        shown = capsys.readouterr()
        needed = "is no bag; expected a folder with one, or a .mcap or .db3 file"
        why = "does not exist" if name == "missing" else needed
        assert (shown.out, shown.err) == ("", f"error: {path} {why}\n")
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("more", [[], ["--repair", "/proc/new"]])
def test_what_may_not_be_opened_is_told_without_advice(
    more: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    os.mknod(tmp_path / "x.mcap", stat.S_IFSOCK | 0o600)  # which not even root can open
    for given in (tmp_path, tmp_path / "x.mcap"):
        assert bag_info.main([str(given), *more]) == 1
        reason = f"{tmp_path / 'x.mcap'} cannot be read: No such device or address"
        assert capsys.readouterr().err == f"error: {reason}\n"


@pytest.mark.parametrize(
    ("name", "why"),
    [("notes.mcap", "it does not begin as an MCAP file does"), ("notes.db3", "file is not a database")],
)
def test_of_a_file_that_is_no_bag_inside_no_empty_bag_is_made(
    name: str, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "notes"
    folder.mkdir()
    (folder / name).write_text("no bag")
    for given in (folder, folder / name):
        assert bag_info.main([str(given), "--repair", str(tmp_path / "new")]) == 1
        told = f"error: {given}: no message can be saved: {name}: {why}\n"
        assert capsys.readouterr() == ("", told)
        assert sorted(path.name for path in tmp_path.iterdir()) == ["notes"]


def test_advice_can_be_typed_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "of today.mcap").write_bytes(b"torn")
    assert bag_info.main([str(tmp_path / "of today.mcap")]) == 1
    assert f"bag_info '{tmp_path}/of today.mcap' --repair NEW_BAG\n" in capsys.readouterr().err


def test_every_cut_of_an_mcap_file_leaves_the_whole_records(tmp_path: Path) -> None:
    seed = 7
    chance = random.Random(seed)
    path = tmp_path / "bag"
    with BagWriter(path, "mcap", keep_free=0) as bag:
        bag.add_topic(BagTopic(name="/a", type=STRING))
        for i in range(60):
            bag.write("/a", i + 1, text(f"{i}"))
            if i % 10 == 9:
                bag.checkpoint()  # a chunk for each ten messages
    whole = storage_file(path).read_bytes()
    last = 0
    for number, size in enumerate(sorted(chance.sample(range(300, len(whole)), 40))):
        cut = tmp_path / f"{number}.mcap"
        cut.write_bytes(whole[:size])
        count, end = repair(cut, tmp_path / f"{number}")
        assert count % 10 == 0 and count >= last and end == "", (seed, size)
        if count:
            with BagReader(tmp_path / f"{number}") as bag:
                assert [bag.decode(d, STRING).data for _, _, d in bag.messages()] == [f"{i}" for i in range(count)]
        last = count
    assert last == 60


def bag_of_six_chunks(path: Path) -> list[tuple[str, int, bytes]]:
    """Write ten messages into each."""
    rows = [("/a", i + 1, text(f"word {i}")) for i in range(60)]
    with BagWriter(path, "mcap", keep_free=0) as bag:
        bag.add_topic(BagTopic(name="/a", type=STRING))
        for i, row in enumerate(rows):
            bag.write(*row)
            if i % 10 == 9:
                bag.checkpoint()
    return rows


def chunks_of(file: Path) -> list[Chunk]:
    """Return the chunks as the official reader finds them."""
    with file.open("rb") as stream:
        return [r for r in StreamReader(stream, emit_chunks=True).records if isinstance(r, Chunk)]


def test_each_chunk_has_its_checksum(tmp_path: Path) -> None:
    """The writer of rosbags writes 0, which readers treat as unknown; ours is set by its attributes `bio` and
    `chunk`."""
    bag_of_six_chunks(tmp_path / "bag")
    chunks = chunks_of(storage_file(tmp_path / "bag"))
    assert [chunk.uncompressed_crc for chunk in chunks] == [zlib.crc32(chunk.data) for chunk in chunks]
    assert len(chunks) == 6 and all(chunk.uncompressed_crc for chunk in chunks)


@pytest.mark.parametrize("number", range(6))
def test_a_chunk_whose_checksum_is_wrong_is_refused_and_all_others_are_saved(
    number: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The first is the only one that declares the topic; the end of the file does so again."""
    rows = bag_of_six_chunks(tmp_path / "bag")
    file = storage_file(tmp_path / "bag")
    data = bytearray(file.read_bytes())
    data[data.index(f"word {number * 10 + 4}\0".encode())] ^= 1  # a vord
    file.write_bytes(data)
    with pytest.raises(CRCValidationError), file.open("rb") as stream:
        list(make_reader(stream, validate_crcs=True).iter_messages())
    assert bag_info.main([str(tmp_path / "bag"), "--check"]) == 1
    assert "checksum" in capsys.readouterr().err
    count, end = repair(tmp_path / "bag", tmp_path / "new")
    at = bytes(data).index(chunks_of(file)[number].data) - 49  # the fields before a chunk's data that is not compressed
    assert end == (
        f"bag.mcap: damaged and left out: 1 of its records, the first at byte {at} (its checksum is wrong); "
        "bag.mcap: 50 of 60 messages are whole"
    )
    with BagReader(tmp_path / "new") as bag:
        assert list(bag.messages()) == rows[: number * 10] + rows[number * 10 + 10 :]
    assert count == 50
    assert bag_info.main([str(tmp_path / "bag"), "--repair", str(tmp_path / "again")]) == 0
    assert capsys.readouterr().out == f"50 messages saved in {tmp_path / 'again'}; not all: {end}\n"


def test_messages_whose_topic_only_a_damaged_chunk_told_are_counted(tmp_path: Path) -> None:
    """The file was cut off, too, so its end does not declare it again."""
    bag_of_six_chunks(tmp_path / "bag")
    data = bytearray(storage_file(tmp_path / "bag").read_bytes())
    data[data.index(b"word 4\0")] ^= 1
    (tmp_path / "x.mcap").write_bytes(data[: data.index(b"word 59\0")])
    count, end = repair(tmp_path / "x.mcap", tmp_path / "new")
    assert count == 0 and end.endswith("(its checksum is wrong); x.mcap: of 40 messages the topic is not known")


@pytest.mark.parametrize("checksums", [True, False])
@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD, CompressionType.NONE])
def test_a_damaged_chunk_in_the_middle_costs_no_other(
    compression: CompressionType, checksums: bool, tmp_path: Path
) -> None:
    """In files of others, with checksums or without."""
    rows = [("/a", i + 1, text(f"{i} " + "long words " * 20)) for i in range(100)]
    file = tmp_path / "theirs.mcap"
    writer = OfficialWriter(str(file), chunk_size=2000, compression=compression, enable_crcs=checksums)
    writer.start("ros2", "test")
    schema = writer.register_schema(STRING, "ros2msg", b"string data\n")
    channel = writer.register_channel("/a", "cdr", schema)
    for _, stamp_ns, content in rows:
        writer.add_message(channel, stamp_ns, content, stamp_ns)
    writer.finish()
    chunks = chunks_of(file)
    hurt = chunks[len(chunks) // 2]
    lost = [row for row in rows if hurt.message_start_time <= row[1] <= hurt.message_end_time]
    assert len(chunks) > 8 and 2 < len(lost) < 20
    data = bytearray(file.read_bytes())
    at = bytes(data).index(hurt.data)
    data[at : at + 12] = b"\xff" * 12  # the frame's head, or the first message's length
    file.write_bytes(data)
    with pytest.raises(BagError, match=r"broken.*--repair"), BagReader(file) as bag:
        list(bag.messages())
    count, end = repair(file, tmp_path / "new")
    assert "damaged and left out: 1 of its records" in end
    assert end.endswith(f"theirs.mcap: {100 - len(lost)} of 100 messages are whole"), end
    with BagReader(tmp_path / "new") as bag:
        assert list(bag.messages()) == [row for row in rows if row not in lost]
    assert count == 100 - len(lost)


def test_no_damage_of_one_byte_is_passed_over(tmp_path: Path) -> None:
    seed = 11
    chance = random.Random(seed)
    rows = bag_of_six_chunks(tmp_path / "bag")
    whole = storage_file(tmp_path / "bag").read_bytes()
    saved_of_all = 0
    for place in chance.sample(range(8, len(whole)), 1500):
        data = bytearray(whole)
        data[place] ^= 1 << chance.randrange(8)
        ends: list[str] = []
        saved = [(c.topic, stamp, m) for c, stamp, m in whole_messages(BytesIO(data), {"": bytes}, ends)]
        assert saved == rows or (ends and set(saved) <= set(rows)), (seed, place)
        saved_of_all += len(saved)
    assert saved_of_all > 1500 * 45, "of most chunks the others are saved"


def test_the_check_of_a_bag_passes_over_no_damage_of_one_byte(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Neither in a chunk nor in the index, without which messages are not found; each is reported in one line."""
    seed = 12
    chance = random.Random(seed)
    rows = bag_of_six_chunks(tmp_path / "bag")
    file = storage_file(tmp_path / "bag")
    whole = file.read_bytes()
    index = whole.rindex(b"serialized_metadata")
    bad = 0
    for place in (*chance.sample(range(index), 50), *chance.sample(range(index, len(whole)), 50)):
        data = bytearray(whole)
        data[place] ^= 1 << chance.randrange(8)
        file.write_bytes(data)
        end = bag_info.main([str(tmp_path / "bag"), "--check"])
        error = capsys.readouterr().err
        if end:
            assert error.startswith("error: ") and error.count("\n") == 1 and ": ;" not in error, (seed, place, error)
            bad += 1
        else:
            with BagReader(tmp_path / "bag") as bag:
                assert list(bag.messages()) == rows, (seed, place)
    assert bad > 25


MINE = "lab_msgs/msg/Mine"


def bag_with_a_definition(folder: Path, rows: list[tuple[str, int, bytes]], encoding: str, definition: str) -> Path:
    """Write /a, of strings, and /mine, whose type is described so, as MCAP."""
    folder.mkdir()
    file = folder / "theirs.mcap"
    writer = OfficialWriter(str(file), compression=CompressionType.NONE)
    writer.start("ros2", "test")
    kinds = {"/mine": (MINE, encoding, definition), "/a": (STRING, "ros2msg", "string data\n")}
    channels = {
        topic: writer.register_channel(topic, "cdr", writer.register_schema(kind, form, of.encode()))
        for topic, (kind, form, of) in kinds.items()
    }
    for topic, stamp_ns, data in rows:
        writer.add_message(channels[topic], stamp_ns, data, stamp_ns)
    writer.finish()
    return file


def bag_without_a_definition(folder: Path, rows: list[tuple[str, int, bytes]]) -> Path:
    """Write the same with sqlite3, as an older recorder does, that wrote no definitions."""
    types = get_typestore(Stores.ROS2_JAZZY)
    types.register(get_types_from_msg("string text", MINE))
    with BagWriter(folder, "sqlite3", keep_free=0, types=types) as bag:
        bag.add_topic(BagTopic(name="/mine", type=MINE))
        bag.add_topic(BagTopic(name="/a", type=STRING))
        for row in rows:
            bag.write(*row)
    with contextlib.closing(sqlite3.connect(storage_file(folder))) as database:
        database.execute("DELETE FROM message_definitions")
        database.commit()
    return storage_file(folder)


@pytest.mark.parametrize(
    ("encoding", "definition"),
    [
        ("", ""),
        ("ros2msg", ""),
        ("ros2msg", "int32 number="),
        ("ros2msg", "other_msgs/Unknown inner"),
        ("ros2msg", "Mine inner"),
        ("ros2idl", "module lab_msgs { module msg { struct Mine { string text; }; }; };"),
        ("sqlite3", ""),
    ],
)
def test_a_topic_whose_definition_is_not_known_costs_no_other(encoding: str, definition: str, tmp_path: Path) -> None:
    rows = [("/mine" if i % 101 == 10 else "/a", i + 1, text(f"{i}")) for i in range(1010)]
    if encoding == "sqlite3":
        file = bag_without_a_definition(tmp_path / "bag", rows)
    else:
        file = bag_with_a_definition(tmp_path / "bag", rows, encoding, definition)
    with BagReader(file) as bag:
        assert list(bag.messages()) == rows
    count, end = repair(file, tmp_path / "new")
    assert (count, end) == (1000, f"{file.name}: /mine: the definition of {MINE} is not known")
    with BagReader(tmp_path / "new") as bag:
        assert list(bag.messages()) == [row for row in rows if row[0] == "/a"]
        assert bag.decode(rows[3][2], STRING).data == "3"


@both
@pytest.mark.parametrize("harm", ["cut off", "damaged"])
def test_a_compressed_bag_is_repaired_as_far_as_it_unpacks(tmp_path: Path, storage: str, harm: str) -> None:
    noise = np.random.default_rng(3).integers(0, 256, (400, 1000), np.uint8)
    with BagWriter(tmp_path / "bag", storage, keep_free=0, zstd=True) as bag:
        bag.add_topic(BagTopic(name="/a", type=STRING))
        for i, row in enumerate(noise):
            bag.write("/a", i + 1, text(f"{i} {row.tobytes().hex()}"))
            if i % 10 == 9:
                bag.checkpoint()
    (file,) = (p for p in (tmp_path / "bag").iterdir() if p.suffix == ".zstd")
    data = bytearray(file.read_bytes())
    place = int(len(data) * 0.7)
    data[place:] = b"" if harm == "cut off" else bytes(9999) + data[place + 9999 :]
    file.write_bytes(data)
    with pytest.raises(BagError, match=r"broken.*--repair"), BagReader(tmp_path / "bag") as bag:
        list(bag.messages())
    for given, new in ((tmp_path / "bag", "new"), (file, "again")):
        count, end = repair(given, tmp_path / new)
        assert file.name in end and ("unpacked" in end if harm == "damaged" else "cut off" in end), end
        assert 200 < count < 300
        with BagReader(tmp_path / new) as bag:
            said = [bag.decode(d, STRING).data.partition(" ")[0] for _, _, d in bag.messages()]
        assert said == [f"{i}" for i in range(count)]
    assert not list(tmp_path.glob("*.unpacked*")), "nothing is left beside the new bag"


@pytest.mark.parametrize("listed", ["bag_1.mcap", "bag/bag_1.mcap", "bag_1.mcap.zstd"])
def test_a_file_of_a_bag_that_is_missing_is_told_by_the_repair(listed: str, tmp_path: Path) -> None:
    write(tmp_path / "bag", "mcap")
    metadata = tmp_path / "bag" / "metadata.yaml"
    described = yaml.safe_load(metadata.read_text())
    described["rosbag2_bagfile_information"]["relative_file_paths"].append(listed)
    metadata.write_text(yaml.safe_dump(described))
    assert repair(tmp_path / "bag", tmp_path / "new") == (20, f"{Path(listed).name} is missing")
    shutil.copyfile(storage_file(tmp_path / "bag"), tmp_path / "bag" / "bag_1.mcap")
    assert repair(tmp_path / "bag", tmp_path / "whole") == (40, "")
    metadata.write_text("rosbag2_bagfile_information: [1")
    assert repair(tmp_path / "bag", tmp_path / "again") == (40, "")


def test_of_a_sqlite_file_that_was_cut_off_the_pages_before_are_saved(tmp_path: Path) -> None:
    """As a copy leaves it that did not fit on the stick; the file itself stays as it is."""
    rows = write(tmp_path / "bag", "sqlite3", 3000)
    file = storage_file(tmp_path / "bag")
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    for given, new in ((tmp_path / "bag", "new"), (file, "again")):
        count, end = repair(given, tmp_path / new)
        assert 300 < count < 3000 and f"{file.name} was cut off" in end, (count, end)
        with BagReader(tmp_path / new) as bag:
            saved = list(bag.messages())
        assert len(saved) == count and set(saved) <= set(rows)
    assert file.read_bytes() == data[: len(data) // 2]
    assert not list(tmp_path.glob("*.unpacked*"))


def test_no_message_of_a_sqlite_file_that_was_cut_off_is_made_up(tmp_path: Path) -> None:
    """The end of one that is longer than a page may be missing while all else of it is there."""
    rows = [("/a", i + 1, text(f"{i} " + "x" * (4000 + 150 * i))) for i in range(30)]
    with BagWriter(tmp_path / "bag", "sqlite3", keep_free=0) as bag:
        bag.add_topic(BagTopic(name="/a", type=STRING))
        for row in rows:
            bag.write(*row)
    file = storage_file(tmp_path / "bag")
    data = file.read_bytes()
    counts = []
    for cut in range(9 * 4096, len(data), 4 * 4096 + 1000):
        file.write_bytes(data[:cut])
        count, _ = repair(file, tmp_path / f"{cut}")
        counts.append(count)
        with BagReader(tmp_path / f"{cut}") as bag:
            assert set(bag.messages()) <= set(rows), cut
    assert 0 < counts[-1] < 30 and counts == sorted(counts), counts


@both
def test_messages_that_were_compressed_one_by_one_are_saved_as_they_were(tmp_path: Path, storage: str) -> None:
    """As ``ros2 bag record --compression-mode message`` has them; only metadata.yaml says so, and may be missing."""
    plugin = StoragePlugin.SQLITE3 if storage == "sqlite3" else StoragePlugin.MCAP
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=plugin)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    rows = [("/a", i + 1, text(f"{i} " + "x" * i)) for i in range(50)]
    with writer:
        connection = writer.add_connection("/a", STRING, typestore=TYPES)
        for _, stamp_ns, data in rows:
            writer.write(connection, stamp_ns, data)
    file = storage_file(tmp_path / "bag")
    assert rows[20][2] not in file.read_bytes()

    def read(path: Path) -> list[tuple[str, int, bytes]]:
        with BagReader(path) as bag:
            return list(bag.messages())

    assert read(tmp_path / "bag") == read(file) == rows
    assert repair(tmp_path / "bag", tmp_path / "whole") == (50, "")
    (tmp_path / "bag" / "metadata.yaml").unlink()
    assert repair(tmp_path / "bag", tmp_path / "cut off") == (50, "")
    assert read(tmp_path / "whole") == read(tmp_path / "cut off") == rows


def test_a_compressed_message_that_is_damaged_costs_no_other(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/a", STRING, typestore=TYPES)
        for i in range(5):
            writer.write(connection, i + 1, text("x" * 100))
    with contextlib.closing(sqlite3.connect(storage_file(tmp_path / "bag"))) as database:
        database.execute("UPDATE messages SET data = substr(data, 1, length(data) - 5) WHERE timestamp = 3")
        database.commit()
    count, end = repair(tmp_path / "bag", tmp_path / "new")
    assert count == 4 and end.endswith("1 messages cannot be unpacked"), end
    with BagReader(tmp_path / "new") as bag:
        assert [stamp_ns for _, stamp_ns, _ in bag.messages()] == [1, 2, 4, 5]
    with pytest.raises(BagError, match=r"broken after 2 messages.*--repair"), BagReader(tmp_path / "bag") as bag:
        list(bag.messages())


def test_damage_in_the_middle_is_named_and_the_rest_is_saved(tmp_path: Path) -> None:
    rows = write(tmp_path / "bag", "sqlite3", 3000)
    file = storage_file(tmp_path / "bag")
    data = bytearray(file.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 8192] = bytes(8192)
    file.write_bytes(data)
    with pytest.raises(BagError, match=r"broken.* malformed.*--repair"), BagReader(tmp_path / "bag") as bag:
        list(bag.messages())
    count, end = repair(tmp_path / "bag", tmp_path / "new")
    assert 100 < count < 3000 and "malformed" in end
    with BagReader(tmp_path / "new") as bag:
        saved = list(bag.messages())
    assert len(saved) == count and set(saved) <= set(rows)


def test_other_files_and_names_are_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match=r"nothing does not exist"):
        BagReader(tmp_path / "nothing")
    (tmp_path / "x.mcap").write_bytes(b"no bag at all")
    with pytest.raises(BagError, match="broken"):
        BagReader(tmp_path / "x.mcap")
    assert repair(tmp_path / "x.mcap", tmp_path / "y")[1] == "x.mcap: it does not begin as an MCAP file does"
    with pytest.raises(BagError, match=r"/proc/new cannot be made: .*No such file or directory"):
        repair(tmp_path / "x.mcap", Path("/proc/new"))
    (tmp_path / "torn").mkdir()
    (tmp_path / "torn" / "metadata.yaml").write_text("a: [")
    with pytest.raises(BagError, match=r"torn is broken: [^\n]*line 1[^\n]*; save what can be read with: [^\n]*$"):
        BagReader(tmp_path / "torn")
    with BagWriter(tmp_path / "z", keep_free=0) as bag, pytest.raises(BagError, match="/q: the definition of a/msg/B"):
        bag.add_topic(BagTopic(name="/q", type="a/msg/B"))
    with pytest.raises(BagError, match=r"z cannot be made: .* exists already"):
        BagWriter(tmp_path / "z", keep_free=0)


def test_a_nearly_full_disk_ends_the_recording_with_a_whole_bag(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = [1 << 30]
    monkeypatch.setattr(
        "icu_bringup.adapters.bag.bag_writer.shutil.disk_usage", lambda place: type("Usage", (), {"free": free[0]})
    )
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", "mcap", keep_free=100_000_000))
    sink.add_topic(BagTopic(name="/a", type=STRING))
    sink.put("/a", 1, text("before"))
    free[0] = 99_000_000
    sink.put("/a", 2, text("x" * (1 << 20)))
    sink.close()
    assert sink.failure.startswith("the disk is full: 99 MB are free at") and "100 MB are kept" in sink.failure
    with BagReader(tmp_path / "bag") as bag:
        assert [bag.decode(d, STRING).data for _, _, d in bag.messages()] == ["before"]


FULL = """
import resource, signal, sys
from pathlib import Path
from icu_bringup.adapters.bag.bag_writer import BagWriter
from icu_bringup.adapters.bag.bags import BagError, BagTopic
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (3_000_000, 3_000_000))
bag = BagWriter(Path(sys.argv[1]), sys.argv[2], keep_free=0)
bag.add_topic(BagTopic(name="/a", type="std_msgs/msg/String"))
try:
    for i in range(1000):
        bag.write("/a", i + 1, bytes([0, 1, 0, 0]) + (9996).to_bytes(4, "little") + b"x" * 9995 + b"\\0")
        if i % 20 == 0:
            bag.checkpoint()
except BagError as error:
    print(error)
"""


@both
def test_a_write_that_fails_leaves_a_bag_that_can_be_repaired(tmp_path: Path, storage: str) -> None:
    """A limit of the file's size stands for a disk that another program fills between two checks."""
    assert signal.SIGXFSZ and resource.RLIMIT_FSIZE
    environment = {"PYTHONPATH": ":".join(p for p in sys.path if p)}
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path / "bag"), storage],
        capture_output=True,
        text=True,
        timeout=60,
        env=environment,
        check=False,
    )
    assert "cannot be written" in done.stdout and "--repair" in done.stdout, done.stdout + done.stderr
    count, _ = repair(tmp_path / "bag", tmp_path / "new")
    assert 200 < count < 300
    with BagReader(tmp_path / "new") as bag:
        assert [stamp for _, stamp, _ in bag.messages()] == list(range(1, count + 1))


@both
def test_what_was_recorded_outlives_the_recorder_also_where_nothing_follows(tmp_path: Path, storage: str) -> None:
    """The contents of a copy of the files would be there after the recorder was killed."""
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", storage, keep_free=0))
    try:
        assert storage_file(tmp_path / "bag").read_bytes().startswith((MAGIC, b"SQLite format 3\0"))
        for burst in range(2):
            if not burst:
                sink.add_topic(BagTopic(name="/a", type=STRING))
            for i in range(3):
                sink.put("/a", burst * 3 + i + 1, text(f"{burst} {i}"))
            stamps, attempt, until_s = [], 0, time.monotonic() + 10.0
            while stamps != list(range(1, burst * 3 + 4)):
                assert time.monotonic() < until_s, (burst, stamps, sink.failure)
                copy, attempt = tmp_path / f"{burst} {attempt}", attempt + 1
                # A journal that sqlite deletes meanwhile, or a copy of two moments, is looked at again.
                with contextlib.suppress(shutil.Error, BagError):
                    shutil.copytree(tmp_path / "bag", copy)
                    repair(copy, copy / "new")
                    with BagReader(copy / "new") as bag:
                        stamps = [stamp for _, stamp, _ in bag.messages()]
                shutil.rmtree(copy)
    finally:
        sink.close()
    assert (sink.failure, sink.messages) == ("", 6)


def test_a_checkpoint_is_due_a_second_after_the_first_message_that_it_saves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not after the last checkpoint, nor after the last message: neither of a slow trickle is then older."""
    now = [100.0]
    monkeypatch.setattr("icu_bringup.adapters.bag.bag_writer.time", SimpleNamespace(monotonic=lambda: now[0]))
    with BagWriter(tmp_path / "bag", keep_free=0) as bag:
        due = [bag.due_s]
        for now[0] in (103.0, 103.9, 104.0, 105.5):
            if now[0] == 103.0:
                bag.add_topic(BagTopic(name="/a", type=STRING))
            bag.write("/a", 1, text("word"))
            due.append(bag.due_s)
        bag.checkpoint()
        due.append(bag.due_s)
    assert due == [None, 104.0, 104.0, None, 106.5, None]
    assert len(chunks_of(storage_file(tmp_path / "bag"))) == 2


def test_the_official_reader_reads_a_recording_whose_topics_are_older_than_its_messages(tmp_path: Path) -> None:
    """They are alone in a chunk, whose times are 0, as the format wants it."""
    with BagWriter(tmp_path / "bag", keep_free=0) as bag:
        bag.add_topic(BagTopic(name="/a", type=STRING))
        bag.checkpoint()
        bag.write("/a", 7, text("word"))
    file = storage_file(tmp_path / "bag")
    assert [(c.message_start_time, c.message_end_time) for c in chunks_of(file)] == [(0, 0), (7, 7)]
    with file.open("rb") as stream:
        assert [m.log_time for _, _, m in make_reader(stream, validate_crcs=True).iter_messages()] == [7]
    for given in (tmp_path / "bag", file):
        with BagReader(given) as bag:
            assert (list(bag.messages()), bag.start_ns) == ([("/a", 7, text("word"))], 7)


def slow_disk() -> tuple[type, threading.Event, list[tuple[str, int, bytes]]]:
    """Return a writer of bags, an event that starts it, and its output after that."""
    gate = threading.Event()
    written: list[tuple[str, int, bytes]] = []

    class Slow:
        messages = bytes = 0
        due_s = None

        def __enter__(self) -> Slow:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def add_topic(self, topic: BagTopic) -> None:
            gate.wait()

        def write(self, *row: Any) -> None:
            written.append(row)

    return Slow, gate, written


def test_a_slow_disk_drops_and_counts() -> None:
    slow, gate, written = slow_disk()
    sink = BagSink(slow, limit_bytes=25)
    sink.add_topic(BagTopic(name="/a", type=STRING))
    for i in range(5):
        sink.put("/a", i, b"0123456789")
    gate.set()
    sink.close()
    assert [row[1] for row in written] == [0, 1] and sink.dropped == 3 and not sink.failure


def test_pictures_leave_room_for_what_is_said_once() -> None:
    slow, gate, written = slow_disk()
    picture, order = bytes(1 << 20), b"go"
    sink = BagSink(slow, limit_bytes=3 * len(picture))
    sink.add_topic(BagTopic(name="/picture", type=IMAGE))
    sink.add_topic(BagTopic(name="/order", type=STRING))
    for i in range(4):
        sink.put("/picture", i, picture)
    for i in range(4):
        sink.put("/order", i, order)
    gate.set()
    sink.close()
    assert [row[1] for row in written if row[0] == "/order"] == [0, 1, 2, 3]
    assert [row[1] for row in written if row[0] == "/picture"] == [0, 1] and sink.dropped == 2


@pytest.mark.parametrize(("encoding", "channels"), [("bgr8", 3), ("rgb8", 3), ("mono8", 1)])
def test_pictures_survive_png_and_nearly_jpeg(encoding: str, channels: int) -> None:
    pixels = cv2.GaussianBlur(np.random.default_rng(3).integers(0, 256, (40, 60, channels), np.uint8), (0, 0), 3)
    pixels = pixels.reshape(40, 60, channels)
    header = TYPES.types["std_msgs/msg/Header"](
        stamp=TYPES.types["builtin_interfaces/msg/Time"](sec=12, nanosec=34), frame_id="eye"
    )
    image = TYPES.types[IMAGE](
        header=header,
        height=40,
        width=60,
        encoding=encoding,
        is_bigendian=0,
        step=60 * channels,
        data=pixels.reshape(-1),
    )
    raw = bytes(TYPES.serialize_cdr(image, IMAGE))
    bgr = pixels[:, :, ::-1] if encoding == "rgb8" else pixels
    for codec, tolerance in ((PictureCodec("png"), 0), (PictureCodec("jpeg", 95), 6)):
        back = TYPES.deserialize_cdr(codec.unpack(codec.pack(raw)), IMAGE)
        assert (back.header.stamp.nanosec, back.header.frame_id, back.step) == (34, "eye", 60 * channels)
        assert back.encoding == ("mono8" if channels == 1 else "bgr8")
        assert np.abs(back.data.reshape(bgr.shape).astype(int) - bgr).max() <= tolerance
    with pytest.raises(ValueError, match="quality = 101: 1 to 100"):
        PictureCodec("jpeg", 101)


def test_pictures_that_cannot_be_compressed_are_kept_as_they_are(tmp_path: Path) -> None:
    """A depth camera in addition to the robot's own does not end the recording."""
    header = TYPES.types["std_msgs/msg/Header"](
        stamp=TYPES.types["builtin_interfaces/msg/Time"](sec=12, nanosec=34), frame_id="eye"
    )

    def picture(encoding: str, size: int) -> bytes:
        data = np.zeros(12 * size, np.uint8)
        image = TYPES.types[IMAGE](
            header=header, height=3, width=4, encoding=encoding, is_bigendian=0, step=4 * size, data=data
        )
        return bytes(TYPES.serialize_cdr(image, IMAGE))

    depth, colour = picture("32FC1", 4), picture("bgr8", 3)
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0), PictureCodec())
    for name in ("/depth", "/colour", "/silent"):
        sink.add_topic(BagTopic(name=name, type=IMAGE))
    for stamp_ns in (1, 2):
        sink.put("/depth", stamp_ns, depth)
        sink.put("/colour", stamp_ns, colour)
    sink.close()
    assert (sink.failure, sink.dropped, sink.messages) == ("", 0, 4)
    with BagReader(tmp_path / "bag") as bag:
        kinds = {topic.name: (topic.type, topic.count) for topic in bag.topics}
        kept = [data for _, _, data in bag.messages(["/depth"])]
    compressed = {name + SUFFIX: (COMPRESSED, count) for name, count in (("/colour", 2), ("/silent", 0))}
    assert kinds == {"/depth": (IMAGE, 2), **compressed} and kept == [depth, depth]


@pytest.mark.parametrize("kind", [COMPRESSED, "std_msgs/msg/String"])
@pytest.mark.parametrize("first", ["/eye", "/eye/compressed"])
def test_pictures_are_not_mixed_with_those_that_somebody_publishes_compressed(
    first: str, kind: str, tmp_path: Path
) -> None:
    """As image_transport does, under the name that ours get."""
    raw, packed = gray_picture()
    theirs = packed if kind == COMPRESSED else b"\0\1\0\0\2\0\0\0x\0"
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0), PictureCodec())
    for topic in sorted([("/eye", IMAGE), ("/eye/compressed", kind)], reverse=first != "/eye"):
        sink.add_topic(BagTopic(name=topic[0], type=topic[1]))
    sink.put("/eye", 1, raw)
    sink.put("/eye/compressed", 2, theirs)
    sink.close()
    assert (sink.failure, sink.messages) == ("", 2)
    with BagReader(tmp_path / "bag") as bag:
        kinds = {topic.name: topic.type for topic in bag.topics}
        kept = [(name, data) for name, _, data in bag.messages()]
    assert kinds == {"/eye/bag_record/compressed": COMPRESSED, "/eye/compressed": kind}
    assert kept == [("/eye/bag_record/compressed", packed), ("/eye/compressed", theirs)]


def test_pictures_that_somebody_publishes_compressed_later_do_not_end_the_recording(tmp_path: Path) -> None:
    raw, packed = gray_picture()
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0), PictureCodec())
    sink.add_topic(BagTopic(name="/eye", type=IMAGE))
    sink.put("/eye", 1, raw)
    sink.add_topic(BagTopic(name="/eye/compressed", type=COMPRESSED))
    sink.put("/eye/compressed", 2, packed)
    sink.put("/eye", 3, raw)
    sink.close()
    assert (sink.failure, sink.messages) == ("", 3)
    with BagReader(tmp_path / "bag") as bag:
        assert [(name, data) for name, _, data in bag.messages()] == [("/eye/compressed", packed)] * 3


def gray_picture() -> tuple[bytes, bytes]:
    """Return a picture as it is published, and compressed."""
    header = TYPES.types["std_msgs/msg/Header"](
        stamp=TYPES.types["builtin_interfaces/msg/Time"](sec=12, nanosec=34), frame_id="eye"
    )
    image = TYPES.types[IMAGE](
        header=header, height=6, width=8, encoding="mono8", is_bigendian=0, step=8, data=np.zeros(48, np.uint8)
    )
    raw = bytes(TYPES.serialize_cdr(image, IMAGE))
    return raw, PictureCodec().pack(raw)


def test_a_picture_that_differs_from_those_before_does_not_end_the_recording(tmp_path: Path) -> None:
    """One of no size, or in another encoding, as of a camera with new settings, is kept with the compressed ones."""
    header = TYPES.types["std_msgs/msg/Header"](
        stamp=TYPES.types["builtin_interfaces/msg/Time"](sec=12, nanosec=34), frame_id="eye"
    )

    def picture(encoding: str, height: int, width: int) -> bytes:
        data = np.zeros(height * width, np.uint8)
        image = TYPES.types[IMAGE](
            header=header, height=height, width=width, encoding=encoding, is_bigendian=0, step=width, data=data
        )
        return bytes(TYPES.serialize_cdr(image, IMAGE))

    good, deep, empty = picture("mono8", 6, 8), picture("8UC4", 6, 8), picture("mono8", 0, 0)
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0), PictureCodec())
    sink.add_topic(BagTopic(name="/eye", type=IMAGE))
    sink.add_topic(BagTopic(name="/joints", type="std_msgs/msg/String"))
    for stamp_ns, data in enumerate((good, deep, empty, good), 1):
        sink.put("/eye", stamp_ns, data)
    sink.put("/joints", 5, b"\0\1\0\0\2\0\0\0x\0")
    sink.close()
    assert (sink.failure, sink.dropped, sink.messages) == ("", 0, 5)
    with BagReader(tmp_path / "bag") as bag:
        kinds = {topic.name: (topic.type, topic.count) for topic in bag.topics}
        kept = [(stamp_ns, data) for _, stamp_ns, data in bag.messages(["/eye"])]
    assert kinds == {
        "/eye": (IMAGE, 2),
        "/eye/compressed": (COMPRESSED, 2),
        "/joints": ("std_msgs/msg/String", 1),
    }
    assert kept == [(2, deep), (3, empty)]


def test_a_bag_that_cannot_be_made_of_a_path_is_told(tmp_path: Path) -> None:
    for path in (Path("/"), tmp_path):
        with pytest.raises(BagError, match=f"{path} exists already"):
            BagSink(lambda path=path: BagWriter(path, keep_free=0))  # type: ignore[misc]
    with pytest.raises(BagError, match="/ exists already"):
        repair(tmp_path, Path("/"))


def test_an_error_without_words_is_told(tmp_path: Path) -> None:
    def fail() -> BagWriter:
        raise MemoryError

    with pytest.raises(BagError, match="MemoryError"):
        BagSink(fail)


def test_an_error_of_any_kind_ends_the_writing_and_is_told(tmp_path: Path) -> None:
    sink = BagSink(lambda: BagWriter(tmp_path / "bag", keep_free=0), PictureCodec())
    sink.add_topic(BagTopic(name="/eye/image_raw", type=IMAGE))
    sink.put("/eye/image_raw", 1, b"\0\1\0\0no picture")
    sink.close()
    assert sink.failure.startswith("error while writing: SerdeError(")
    sink.put("/eye/image_raw", 2, b"later")
    assert sink.dropped == 1 and sink.messages == 0


def test_a_bag_that_cannot_be_made_is_told_whatever_the_error(tmp_path: Path) -> None:
    with pytest.raises(BagError, match="File name too long"):
        BagSink(lambda: BagWriter(tmp_path / ("x" * 300) / "bag"))


def compressed(data: np.ndarray, form: str) -> bytes:
    header = TYPES.types["std_msgs/msg/Header"](
        stamp=TYPES.types["builtin_interfaces/msg/Time"](sec=12, nanosec=34), frame_id="eye"
    )
    message = TYPES.types[COMPRESSED](header=header, format=form, data=data)
    return bytes(TYPES.serialize_cdr(message, COMPRESSED))


@pytest.mark.parametrize(
    ("kind", "channels", "form", "encoding"),
    [
        (np.uint8, 4, "bgra8; png compressed bgra8", "bgra8"),
        (np.uint16, 1, "mono16; png compressed ", "mono16"),
        (np.uint16, 1, "16UC1; png compressed ", "16UC1"),
        (np.uint16, 3, "bgr16; png compressed bgr16", "bgr16"),
    ],
)
def test_pictures_that_others_packed_keep_their_channels_and_depth(
    kind: type[np.generic], channels: int, form: str, encoding: str
) -> None:
    pixels = np.random.default_rng(3).integers(0, np.iinfo(kind).max, (6, 8, channels), kind)
    back = TYPES.deserialize_cdr(
        PictureCodec().unpack(compressed(cv2.imencode(".png", pixels)[1].ravel(), form)), IMAGE
    )
    assert (back.encoding, back.height, back.width) == (encoding, 6, 8)
    assert back.step == 8 * channels * pixels.itemsize and len(back.data) == 6 * back.step
    assert np.array_equal(back.data.view(kind).reshape(pixels.shape), pixels)


def test_broken_pictures_are_refused_with_the_reason() -> None:
    for data in (np.empty(0, np.uint8), np.frombuffer(b"no picture", np.uint8)):
        with pytest.raises(ValueError, match="a picture with the format 'jpeg' cannot be decoded"):
            PictureCodec().unpack(compressed(data, "jpeg"))
    with pytest.raises(ValueError, match="not a sensor_msgs/msg/CompressedImage"):
        PictureCodec().unpack(b"\0\1\0\0\1")


def test_the_play_clock_pauses_and_runs_at_its_rate() -> None:
    clock = PlayClock(1000, 2.0, 10.0, paused=True)
    assert clock.bag_ns(50.0) == 1000 and clock.wall_s_until(2000, 50.0) == float("inf")
    assert clock.toggle(50.0) is False
    assert clock.bag_ns(51.0) == 2_000_001_000
    assert clock.wall_s_until(4_000_001_000, 51.0) == pytest.approx(1.0)
    assert clock.toggle(51.5) is True and clock.bag_ns(99.0) == 3_000_001_000
    with pytest.raises(ValueError, match=r"rate = 0: 0\.001 to 1000"):
        PlayClock(0, 0, 0.0)
    assert progress_bar(0.5, 4) == "[##..]"
