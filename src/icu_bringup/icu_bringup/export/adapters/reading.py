"""Sessions and cameras of a bag, and the libraries that only some export forms need."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Collection, Iterator
from typing import Any

from rosbags.serde import SerdeError

from icu_bringup.adapters.bag.bag_pictures import COMPRESSED, IMAGE, SUFFIX
from icu_bringup.adapters.bag.bag_reader import BagReader
from icu_bringup.adapters.bag.bags import BagError
from icu_bringup.export.core.session import TOPICS, RecordedSession

LIBRARIES = {"pyarrow": "pyarrow>=18", "rerun": "rerun-sdk==0.41.0"}
"""Module and requirement for pip, as in the extra ``export`` of setup.py. The interface of rerun changes."""


def require(*modules: str) -> None:
    """Import optional libraries.

    Raises
    ------
    BagError
        If a library is missing; the text names the command that installs it.
    """
    for module in modules:
        try:
            importlib.import_module(module)
        except ImportError as error:
            command = f"{sys.executable} -m pip install '{LIBRARIES[module]}'"
            raise BagError(f"{module} is missing: install it with: {command}") from error


def namespace_of(text: str) -> str:
    """Return an option's namespace in the form at the start of topics: "" or /bed_1."""
    return "/" + text.strip("/") if text.strip("/") else ""


def kinds_of(bag: BagReader) -> dict[str, str]:
    """Return the type of each topic that has messages."""
    return {topic.name: topic.type for topic in bag.topics if topic.count}


def decoded(bag: BagReader, topics: set[str], start_ns: int = 0, stop_ns: int = 0) -> Iterator[tuple[str, int, Any]]:
    """Yield (topic, time of reception in ns, message) in the order of time; the limits are those of a BagReader."""
    kinds = kinds_of(bag)
    for topic, received_ns, data in bag.messages(topics, start_ns, stop_ns):
        try:
            message = bag.decode(data, kinds[topic])
        except SerdeError as error:
            raise BagError(f"{topic}: {error}") from error
        yield topic, received_ns, message


def session_of(bag: BagReader, namespace: str = "", topics: Collection[str] = tuple(TOPICS)) -> RecordedSession:
    """Return the session of the robot in a namespace, which begins with / unless it is empty.

    ``topics`` are the topics to read, without the namespace.
    """
    session, kinds = RecordedSession(), kinds_of(bag)
    wanted = {namespace + topic for topic in topics if kinds.get(namespace + topic) == TOPICS[topic]}
    for topic, received_ns, message in decoded(bag, wanted):
        session.take(topic.removeprefix(namespace), received_ns, message)
    return session


def image_topics(bag: BagReader) -> list[str]:
    """Return the topics with images."""
    return [topic.name for topic in bag.topics if topic.type in (IMAGE, COMPRESSED) and topic.count]


def cameras(bag: BagReader, namespace: str = "") -> dict[str, str]:
    """Return a name for each image topic of a camera; of raw and compressed, the topic with more messages.

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
