"""Standard rosbag2 bags (sqlite3 and MCAP), by the rosbags library: topics, and errors that state what to do.

Messages stay the bytes that the middleware delivered (CDR). A bag stays readable whenever its writer ends. The writer
closes the bag before the disk is full, and hands received messages to the operating system within a second.
``bag_repair`` repairs a bag that was truncated nevertheless.
"""

from __future__ import annotations

import importlib
import shlex
import struct
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import apsw
from rosbags.interfaces import Qos
from rosbags.rosbag2 import ReaderError

ZSTD: Any = importlib.import_module(
    "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
)  # as rosbags
READ_ERRORS = (
    *(ReaderError, apsw.Error, OSError, ValueError, KeyError, TypeError, AssertionError, EOFError),
    # lz4 raises RuntimeError; the last two come from damaged lengths.
    *(ZSTD.ZstdError, RuntimeError, struct.error, OverflowError, MemoryError),
)
ZIPPED = ".zstd"


class BagError(Exception):
    """A bag cannot be read or written; the text states the reason and a remedy."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BagTopic:
    """One topic of a bag.

    Parameters
    ----------
    name, type
        Name as in ROS; type as ``package/msg/Name``.
    count
        Number of messages in the files.
    qos
        The profiles that its publishers offered.
    announced
        Number of messages according to metadata.yaml.
    hash
        Hash of the type's definition in the bag (RIHS01), "" if the bag has none.
    """

    name: str
    type: str
    count: int = 0
    qos: tuple[Qos, ...] = ()
    announced: int = 0
    hash: str = ""


def plain_name(file: Path) -> str:
    return file.name.removesuffix(ZIPPED)


def reason_of(error: BaseException) -> str:
    """Return the text of an error in one line: that of metadata.yaml has several lines, others have none."""
    return " ".join(str(error).split()) or repr(error)


def advice(path: Path) -> str:
    """Return the advice for a broken bag."""
    return f"save what can be read with: bag_info {shlex.quote(str(path))} --repair NEW_BAG"
