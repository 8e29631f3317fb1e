"""Reads a bag's messages for a comparison, and writes the expected ones."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Mapping
from pathlib import Path

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bag_writer import BagWriter
from icu_bringup.adapters.bag.bags import BagTopic
from icu_bringup.core.check.comparison import ComparedMessage, TopicMessages
from icu_bringup.core.check.values import Kind, Value, stamp_ns, values_of
from icu_common.core.configuration.text_bounds import plain


def read_messages(path: Path, topics: Collection[str] | None = None) -> dict[str, TopicMessages]:
    """Return the messages of a bag by topic, all or the named ones.

    Raises
    ------
    BagError
        If the bag cannot be read.
    """
    with BagReader(path) as bag:
        types = {topic.name: topic.type for topic in bag.topics if topics is None or topic.name in topics}
        found: dict[str, list[ComparedMessage]] = {name: [] for name in types}
        for topic, _, data in bag.messages(list(types)):
            message = bag.decode(data, types[topic])
            values = {path: _printable(value) for path, value in values_of(message).items()}
            found[topic].append(ComparedMessage(stamp_ns=stamp_ns(message), values=values))
    return {name: TopicMessages(type=types[name], messages=tuple(messages)) for name, messages in found.items()}


def _printable(value: Value) -> Value:
    """Return a value whose text can be printed: it comes from other programs."""
    return Value(Kind.TEXT, value.data, plain(value.text)) if value.kind is Kind.TEXT else value


def write_expected(results: Path, expected: Path, every: Mapping[str, int]) -> None:
    """Write the expected messages into a new bag: of each named topic of ``results`` each ``every``-th."""
    if expected.exists():
        shutil.rmtree(expected)
    with BagReader(results) as bag, BagWriter(expected, "mcap", types=bag.types, zstd=True) as writer:
        for topic in bag.topics:
            if topic.name in every:
                writer.add_topic(BagTopic(name=topic.name, type=topic.type, qos=topic.qos))
        counts = dict.fromkeys(every, 0)
        for name, time_ns, data in bag.messages(list(every)):
            if counts[name] % every[name] == 0:
                writer.write(name, time_ns, data)
            counts[name] += 1
