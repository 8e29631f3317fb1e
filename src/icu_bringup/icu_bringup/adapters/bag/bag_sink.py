"""Writes a bag in its own thread, so that a slow disk delays no caller; messages that do not fit are counted."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping

from icu_bringup.adapters.bag.bag_pictures import BESIDE, COMPRESSED, IMAGE, SUFFIX, PictureCodec
from icu_bringup.adapters.bag.bag_writer import BagWriter
from icu_bringup.adapters.bag.bags import BagError, BagTopic
from icu_bringup.core.bag.image_gate import ImageGate

_LARGE = 1 << 16
"""Minimum size in bytes of a message that counts as an image or a cloud."""


class BagSink:
    """A queue in front of a :class:`BagWriter`, which lives in the thread (a sqlite3 connection belongs to one).

    Parameters
    ----------
    open_writer
        Creates the bag.
    codec
        Compresses images. With None, all images are written unchanged; images that it cannot compress always are.
    limit_bytes
        Maximum size of the queue in bytes. Images and clouds leave a part of it to small messages; it is reported once.
    rates_hz
        Maximum rate of topics.

    Attributes
    ----------
    failure
        Why writing has ended, empty while it works.
    dropped
        Number of received messages that are not in the bag: the queue was full, or the recording had failed.
    dropped_by_topic
        The same number by topic.
    thinned
        Number of messages left out because of ``rates_hz``.
    messages, bytes
        Number of messages and bytes in the bag.

    Raises
    ------
    BagError
        If the bag cannot be created.
    """

    def __init__(
        self,
        open_writer: Callable[[], BagWriter],
        codec: PictureCodec | None = None,
        *,
        limit_bytes: int = 256 << 20,
        rates_hz: Mapping[str, float] | None = None,
    ) -> None:
        self._open, self._codec, self._limit = open_writer, codec, limit_bytes
        self._waiting: deque[BagTopic | tuple[str, int, bytes]] = deque()
        self._size = self.messages = self.bytes = self.thinned = 0
        self.dropped_by_topic: Counter[str] = Counter()
        self._gate = ImageGate(rates_hz)
        self._topics: set[str] = set()
        self.failure = ""
        self._ending = self._opened = False
        self._pictures: dict[str, BagTopic] = {}
        self._packed_names: dict[str, str] = {}
        self._announced: set[str] = set()
        self._change = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="bag")
        self._thread.start()
        with self._change:
            self._change.wait_for(lambda: self._opened or self.failure)
        if self.failure:
            self._thread.join()
            raise BagError(self.failure)

    def add_topic(self, topic: BagTopic) -> None:
        """Announce a topic; an unknown type becomes the failure."""
        with self._change:
            self._topics.add(topic.name)
            self._waiting.append(topic)
            self._change.notify()

    @property
    def dropped(self) -> int:
        """Number of received messages that are not in the bag."""
        return self.dropped_by_topic.total()

    def put(self, topic: str, stamp_ns: int, data: bytes) -> None:
        """Queue a message."""
        with self._change:
            if len(data) >= _LARGE and not self.failure:
                loss = self._gate.decide(topic, data, self._size, self._limit * 7 // 8, self._topics)
            elif self._size + len(data) > self._limit or self.failure:
                loss = "room"
            else:
                loss = "rate" if self._gate.too_fast(topic, stamp_ns) else ""
            if loss:
                if loss == "rate":
                    self.thinned += 1
                else:
                    self.dropped_by_topic[topic] += 1
                return
            self._waiting.append((topic, stamp_ns, data))
            self._size += len(data)
            self._change.notify()

    def close(self) -> None:
        """Write the queued messages and close the bag; ``failure`` is empty if that succeeded."""
        with self._change:
            self._ending = True
            self._change.notify()
        self._thread.join()

    def _work(self) -> None:
        try:
            writer = self._open()
        except Exception as error:
            # The constructor waits for it.
            self._fail(error)
            return
        with self._change:
            self._opened = True
            self._change.notify()
        try:
            with writer:
                for item in self._items(writer):
                    self._write(writer, item)
                for topic in self._pictures.keys() - {name.removesuffix(SUFFIX) for name in self._announced}:
                    self._announce(writer, topic, compressed=True)
        except (BagError, ValueError) as error:
            self._fail(error)
        except Exception as error:
            # An error in a thread is not reported, and the recorder would continue without writing anything.
            self._fail(RuntimeError(f"error while writing: {error!r}"))

    def _items(self, writer: BagWriter) -> Iterator[BagTopic | tuple[str, int, bytes]]:
        """Yield the items to write; when none follows, give the written ones to the operating system in time."""
        while True:
            with self._change:
                wait_s = None if writer.due_s is None else writer.due_s - time.monotonic()
                self._change.wait_for(lambda: self._waiting or self._ending, wait_s)
                item = self._waiting.popleft() if self._waiting else None
                if item is None and self._ending:
                    return
            if item is None:
                writer.checkpoint()  # without the lock: a slow disk must not delay callers of put()
            else:
                yield item

    def _write(self, writer: BagWriter, item: BagTopic | tuple[str, int, bytes]) -> None:
        if isinstance(item, BagTopic):
            if self._codec is not None and item.type == IMAGE:
                self._pictures[item.name] = item  # its first image shows whether it can be compressed
                for name in {item.name, self._packed_names.get(item.name, item.name)} & self._announced:
                    writer.change_qos(name, item.qos)
            elif item.name in self._announced:
                writer.change_qos(item.name, item.qos)
            else:
                self._add(writer, item)
            return
        topic, stamp_ns, data = item
        with self._change:
            self._size -= len(data)
        if topic in self._pictures:
            packed = self._packed(data)
            topic = self._announce(writer, topic, compressed=packed is not None)
            data = data if packed is None else packed
        writer.write(topic, stamp_ns, data)
        self.messages, self.bytes = writer.messages, writer.bytes

    def _packed(self, data: bytes) -> bytes | None:
        """Return the compressed image, None for one that is kept unchanged."""
        assert self._codec is not None
        try:
            return self._codec.pack(data)
        except ValueError:
            return None

    def _announce(self, writer: BagWriter, topic: str, *, compressed: bool) -> str:
        """Announce the topic under which images are written, and return its name."""
        name, kind = topic, IMAGE
        if compressed:
            beside = BESIDE if topic + SUFFIX in self._announced else ""  # by another program, before the first image
            name, kind = self._packed_names.setdefault(topic, topic + beside + SUFFIX), COMPRESSED
        self._add(writer, BagTopic(name=name, type=kind, qos=self._pictures[topic].qos))
        return name

    def _add(self, writer: BagWriter, topic: BagTopic) -> None:
        # A program that begins to publish compressed images as well uses the name that they had here until then.
        if topic.name not in self._announced:
            self._announced.add(topic.name)
            writer.add_topic(topic)

    def _fail(self, error: Exception) -> None:
        with self._change:
            self.failure = str(error) or repr(error)
            self._change.notify()
