"""Definitions of message types: Jazzy's common interfaces, and the definitions in a bag."""

from __future__ import annotations

import contextlib
import functools
import re

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
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


def hash_of(kind: str, definition: MessageDefinition) -> str:
    """Return the hash of a definition, "" if it is empty or invalid.

    rosbags reads ``char`` as ``uint8``, which has the same bytes and another hash.
    """
    if definition.format is not MessageDefinitionFormat.MSG or _CHAR.search(definition.data):
        return ""
    types = get_typestore(Stores.EMPTY)
    try:
        types.register(get_types_from_msg(definition.data, kind))
        return types.hash_rihs01(kind)
    except (TypesysError, KeyError, RecursionError, AssertionError):
        return ""
