"""Reads one standard bag: its topics, times and messages."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat, Qos
from rosbags.rosbag2 import Reader
from rosbags.typesys.store import Typestore

from icu_bringup.adapters.bag.bags import READ_ERRORS, ZSTD, BagError, BagTopic, advice, plain_name, reason_of
from icu_bringup.adapters.bag.definitions import decode, hash_of, with_definitions
from icu_bringup.adapters.bag.mcap_reader import Times
from icu_bringup.adapters.bag.readers import BagFileReader, joined
from icu_bringup.adapters.bag.ros1 import conversion_advice, is_ros1

_ZSTD_FRAME = b"\x28\xb5\x2f\xfd"
"""Start of a message that was compressed by itself; the first byte of CDR is 0. Only metadata.yaml states the
compression, and a single file or a truncated recording has none."""
T = TypeVar("T")


class BagReader:
    """An open bag, as a context manager.

    Parameters
    ----------
    path
        The folder with metadata.yaml, or a single .db3 or .mcap file.

    Raises
    ------
    BagError
        If it cannot be read; with advice if it was only truncated.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        storage_files(path)
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            raise BagError(f"{path} has no metadata.yaml: its recording was cut off; {advice(path)}")
        self._reader = self._explained(lambda: BagFileReader(path))
        self._explained(self._reader.open)
        self.types = _types_of(self._reader)

    def _explained(self, call: Callable[[], T]) -> T:
        try:
            return call()
        except READ_ERRORS as error:
            raise BagError(f"{self.path} is broken: {reason_of(error)}; {advice(self.path)}") from error

    @property
    def topics(self) -> list[BagTopic]:
        """All topics, by name."""
        announced = self._reader.announced
        found = [
            BagTopic(
                name=c.topic,
                type=c.msgtype,
                count=c.msgcount,
                qos=_qos_of(c),
                announced=announced.get(key, 0),
                hash=c.digest or hash_of(c.msgtype, c.msgdef),
            )
            for key, c in joined(self._reader.connections).items()
        ]
        return sorted(found, key=lambda topic: (topic.name, topic.type))

    @property
    def start_ns(self) -> int:
        """Time in ns at which the first message was received."""
        return self._reader.start_time if self._reader.message_count else 0

    @property
    def duration_ns(self) -> int:
        """Time in ns from the first to the last message."""
        return max(0, self._reader.duration - 1)

    @property
    def count(self) -> int:
        """Number of messages."""
        return self._reader.message_count

    def messages(
        self, topics: Collection[str | BagTopic] | None = None, start_ns: int = 0, stop_ns: int = 0
    ) -> Iterator[tuple[str, int, bytes]]:
        """Yield (topic, time of reception in ns, CDR bytes) of all topics or the named ones, in order of time.

        Parameters
        ----------
        topics
            Names, or topics if a name has several types; None: all.
        start_ns, stop_ns
            Only messages from, and before, these times; 0: no limit.

        Raises
        ------
        BagError
            If the bag is broken, after the messages before the damage.
        """
        kinds = {(t.name, t.type) for t in topics or () if isinstance(t, BagTopic)}
        wanted = [
            c for c in self._reader.connections if topics is None or c.topic in topics or (c.topic, c.msgtype) in kinds
        ]
        if not wanted:
            return
        rows = self._reader.messages(wanted, start=start_ns or None, stop=stop_ns or None)
        done = 0
        while True:
            try:
                connection, stamp_ns, stored = next(rows)
                data = message_of(bytes(stored))
            except StopIteration:
                return
            except READ_ERRORS as error:
                where = f"{self.path} is broken after {done} messages"
                raise BagError(f"{where}: {reason_of(error)}; {advice(self.path)}") from error
            done += 1
            yield connection.topic, stamp_ns, data

    def times(self) -> dict[str, Times]:
        """Return the times of reception in ns of all messages, sorted, by topic; contents are not read.

        Raises
        ------
        BagError
            If the index is broken.
        """
        return {topic: times for topic, times in self._explained(self._reader.times).items() if times.size}

    def check(self) -> int:
        """Read every message, and return how many there are.

        Raises
        ------
        BagError
            If the bag is broken, or its index does not lead to all messages.
        """
        count, there = sum(1 for _ in self.messages()), sum(self._reader.announced.values()) or self.count
        if count != there:
            raise BagError(f"{self.path} is broken: {count} of {there} messages found; {advice(self.path)}")
        return count

    def decode(self, data: bytes, msgtype: str) -> Any:
        """Return the message as rosbags' own object, without ROS."""
        return decode(self.types, data, msgtype)

    def close(self) -> None:
        self._reader.close()

    def __enter__(self) -> BagReader:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def storage_files(path: Path) -> list[Path]:
    """Return the .db3 and .mcap files of a bag, compressed or not; there may be none next to metadata.yaml."""
    try:
        if not path.exists():
            raise BagError(f"{path} does not exist")
        if is_ros1(path):
            raise BagError(conversion_advice(path))
        inside = sorted(path.iterdir()) if path.is_dir() else [path]
        found = [p for p in inside if plain_name(p).endswith((".db3", ".mcap"))]
        described = [p for p in inside if p != path and p.name == "metadata.yaml"]
        for file in (*found, *described):
            with file.open("rb"):
                pass
    except OSError as error:
        raise BagError(f"{error.filename} cannot be read: {error.strerror}") from error
    if not found and not described:
        raise BagError(f"{path} is no bag; expected a folder with one, or a .mcap or .db3 file")
    return found


def message_of(stored: bytes) -> bytes:
    """Return a stored message, decompressed if it was compressed by itself."""
    return bytes(ZSTD.decompress(stored)) if stored.startswith(_ZSTD_FRAME) else stored


def _types_of(reader: Reader) -> Typestore:
    texts = {c.msgtype: c.msgdef.data for c in reader.connections if c.msgdef.format is MessageDefinitionFormat.MSG}
    return with_definitions(texts)


def _qos_of(connection: Connection) -> tuple[Qos, ...]:
    assert isinstance(connection.ext, ConnectionExtRosbag2)
    return tuple(connection.ext.offered_qos_profiles)
