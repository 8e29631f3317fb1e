"""Sessions and cameras of a bag, and the libraries that only some forms of an export need."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from typing import Any

from rosbags.serde import SerdeError

from scope_bench.adapters.bag_pictures import COMPRESSED, IMAGE, SUFFIX
from scope_bench.adapters.bags import BagError, BagReader
from scope_bench.export.core.session import TOPICS, Session

LIBRARIES = {"pyarrow": "pyarrow>=18", "rerun": "rerun-sdk==0.41.0"}
"""Module and requirement for pip, as in the extra ``export`` of setup.py. The interface of rerun changes."""


def require(*modules: str) -> None:
    """Import optional libraries.

    Raises
    ------
    BagError
        If one is missing; names the command that installs it.
    """
    for module in modules:
        try:
            importlib.import_module(module)
        except ImportError as error:
            command = f"{sys.executable} -m pip install '{LIBRARIES[module]}'"
            raise BagError(f"{module} is missing: install it with: {command}") from error


def namespace_of(text: str) -> str:
    """Return an option's namespace as topics begin with it: "" or /bed_1."""
    return "/" + text.strip("/") if text.strip("/") else ""


def kinds_of(bag: BagReader) -> dict[str, str]:
    """Return the type of each topic that has messages."""
    return {topic.name: topic.type for topic in bag.topics if topic.count}


def decoded(bag: BagReader, topics: set[str]) -> Iterator[tuple[str, int, Any]]:
    """Yield (topic, time of reception in ns, message) in the order of time."""
    kinds = kinds_of(bag)
    for topic, received_ns, data in bag.messages(topics):
        try:
            message = bag.decode(data, kinds[topic])
        except SerdeError as error:
            raise BagError(f"{topic}: {error}") from error
        yield topic, received_ns, message


def session_of(bag: BagReader, namespace: str = "") -> Session:
    """Return the session of the robot in a namespace, which begins with / unless it is empty."""
    session, kinds = Session(), kinds_of(bag)
    wanted = {namespace + topic for topic, kind in TOPICS.items() if kinds.get(namespace + topic) == kind}
    for topic, received_ns, message in decoded(bag, wanted):
        session.take(topic.removeprefix(namespace), received_ns, message)
    return session


def times_of(bag: BagReader) -> dict[str, list[int]]:
    """Return the times of reception in ns of all messages, by topic."""
    times: dict[str, list[int]] = {}
    for topic, received_ns, _ in bag.messages():
        times.setdefault(topic, []).append(received_ns)
    return times


def image_topics(bag: BagReader) -> list[str]:
    """Return the topics with images."""
    return [topic.name for topic in bag.topics if topic.type in (IMAGE, COMPRESSED) and topic.count]


def cameras(bag: BagReader, namespace: str = "") -> dict[str, str]:
    """Return a name for each topic with a camera's images, of raw and compressed ones the topic with more messages.

    Cameras of this graph are ``left`` and ``right``; others are named by their topic.
    """
    chosen: dict[str, tuple[int, str]] = {}
    for topic in bag.topics:
        base = topic.name.removesuffix(SUFFIX)
        if topic.count and topic.type in (IMAGE, COMPRESSED) and base.endswith("/image_raw"):
            if not base.startswith(f"{namespace}/") or "/panel/teach/" in base:
                continue
            path = base.removeprefix(namespace).removesuffix("/image_raw").removeprefix("/stereo")
            name = path.strip("/").replace("/", "_") or "camera"
            chosen[name] = max(chosen.get(name, (0, "")), (topic.count, topic.name))
    return {topic: name for name, (_, topic) in sorted(chosen.items())}
