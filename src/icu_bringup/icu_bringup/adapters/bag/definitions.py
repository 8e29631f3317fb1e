"""Definitions of message types: Jazzy's common interfaces, and the definitions in a bag."""

from __future__ import annotations

import contextlib
import functools
import re
import struct
from typing import Any

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

_CHAR = re.compile(r"^\s*char\b", re.MULTILINE)


def is_known(kind: str) -> bool:
    """Return whether a bag can describe this type without a given definition."""
    return kind in _known_types().types


@functools.cache
def _known_types() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)


def written_hash(kind: str) -> str:
    """Return the hash that this project's bags contain for a type of Jazzy, "" for any other type."""
    return _known_types().hash_rihs01(kind) if is_known(kind) else ""


def with_definitions(definitions: dict[str, str]) -> Typestore:
    """Return the known types and those of the given definitions."""
    types = get_typestore(Stores.ROS2_JAZZY)
    for name, text in definitions.items():
        if name not in types.types and text:
            # An invalid definition makes only its own topics unknown.
            with contextlib.suppress(TypesysError):
                new = get_types_from_msg(text, name)
                types.register({key: value for key, value in new.items() if key not in types.types})
    return types


def describes(types: Typestore, kind: str) -> bool:
    """Return whether a type and all its parts are known, as a bag's metadata requires."""
    try:
        types.generate_msgdef(kind, ros_version=2)
        types.hash_rihs01(kind)
    except (TypesysError, KeyError, RecursionError):  # a definition may contain itself
        return False
    return True


def decode(types: Typestore, data: bytes, kind: str) -> Any:
    """Return a message as rosbags' own object.

    rclpy's ``serialize_message`` appends bytes, more with each empty sequence of doubles; they are ignored, as the
    middleware does. rosbags itself rejects more than three.

    Raises
    ------
    SerdeError
        If the message is no CDR, too short for its type, or the type is not known.
    """
    if len(data) < 4 or data[0] or data[1] > 1:
        raise SerdeError(f"a message of {kind} is no CDR")
    try:
        known = types.get_msgdef(kind)
        read = known.deserialize_cdr_le if data[1] else known.deserialize_cdr_be
        return read(data[4:], 0, known.cls, types)[0]
    except (KeyError, TypesysError) as error:
        raise SerdeError(f"the definition of {kind} is not known") from error
    except (struct.error, UnicodeDecodeError, ValueError, IndexError) as error:
        raise SerdeError(f"a message of {kind} cannot be read: {error}") from error


def hash_of(kind: str, definition: MessageDefinition) -> str:
    """Return the hash of a definition, "" if it is empty or invalid.

    A recorder that does not find a definition writes an empty text, as that of std_msgs/Empty is. rosbags reads
    ``char`` as ``uint8``, which has the same bytes and another hash.
    """
    text = definition.data
    if definition.format is not MessageDefinitionFormat.MSG or not text.strip() or _CHAR.search(text):
        return ""
    types = get_typestore(Stores.EMPTY)
    try:
        types.register(get_types_from_msg(text, kind))
        return types.hash_rihs01(kind)
    except (TypesysError, KeyError, RecursionError, AssertionError):
        return ""
