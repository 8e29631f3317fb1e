"""Compare the message types of a bag with the installed ones."""

from __future__ import annotations

import functools
import json
import os
import sys
from pathlib import Path

from rclpy.serialization import deserialize_message, serialize_message

from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bags import BagTopic
from icu_bringup.adapters.bag.definitions import written_hash
from icu_bringup.nodes.bag_qos import message_class

_PADDING = 3
"""Maximum difference in bytes between two CDR writers at the end of a message."""


@functools.cache
def installed_hash(kind: str) -> str:
    """Return the hash (RIHS01) of the installed ``package/msg/Name``, "" if it has none (Humble)."""
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix]
    for prefix in prefixes:
        file = Path(prefix, "share", f"{kind}.json")
        if file.is_file():
            hashes = json.loads(file.read_text(encoding="utf-8"))["type_hashes"]
            return str(next((one["hash_string"] for one in hashes if one["type_name"] == kind), ""))
    return ""


def type_problem(bag: BagReader, topic: BagTopic) -> str:
    """Return why no local subscriber could read a topic's messages, "" if no reason is known.

    The hash of the bag's definition is compared. A bag without definitions (Foxy, Humble in sqlite3) only has
    messages: the first one must have the length that the installed type gives it.
    """
    try:
        message = message_class(topic.type)
    except (ImportError, AttributeError, ValueError):
        return f"{topic.type} is not installed here"
    installed = installed_hash(topic.type)
    if topic.hash and installed:
        same = topic.hash in (installed, written_hash(topic.type))
        return "" if same else f"{topic.type} has another definition here than in the bag"
    first = next((data for _, _, data in bag.messages([topic])), None)
    if first is None:
        return ""
    try:
        fits = abs(len(serialize_message(deserialize_message(first, message))) - len(first)) <= _PADDING
    except Exception:  # each middleware has its own exceptions for unreadable bytes
        fits = False
    return "" if fits else f"{topic.type} has another definition here than in the bag: its first message cannot be read"
