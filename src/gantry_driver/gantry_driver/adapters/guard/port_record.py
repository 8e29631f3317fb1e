"""The record of an open port: the data with which the next guard holds the machine and lifts the stylus without a node.

A guard writes it when it has opened its port, and deletes it when it closes the port in order. So a record that exists
while no guard runs belongs to a guard that was killed.
"""

from __future__ import annotations

import contextlib
import json
import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gantry_driver.adapters.guard.places import guard_path
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.guard.messages import config_of, config_values

FORMAT = 1
MAX_BYTES = 64 * 1024
"""Maximum size of a record in bytes; a record of the longest texts is far smaller."""
_BOOT = Path("/proc/sys/kernel/random/boot_id")


class RecordRefused(ValueError):
    """The record does not belong to the machine that is connected now; the message gives the reason."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PortRecord:
    """State of a guard when it opened its port.

    Attributes
    ----------
    config
        The driver's configuration.
    device
        Identity of the opened device, as :func:`device_identity` returns it.
    stop_path
        Path of the socket for stops that bypass the graph.
    simulated
        Whether the node's clock was not the steady one.
    hangs_up
        Whether the last close of the port lowered its DTR line before a guard changed that.
    """

    config: DriverConfig
    device: tuple[int, ...]
    stop_path: Path
    simulated: bool
    hangs_up: bool


def record_path(socket_path: Path) -> Path:
    """Return the path of the record of the guard with this socket."""
    return socket_path.with_name(f"{socket_path.name}.port")


def device_identity(found: os.stat_result) -> tuple[int, ...]:
    """Return numbers that differ between two devices, also if the second one gets the path of the first."""
    return found.st_dev, found.st_ino, found.st_rdev


def write_record(path: Path, record: PortRecord) -> None:
    """Replace the record atomically, readable only by this user.

    Raises
    ------
    OSError
        If it cannot be written; the old one is deleted then.
    """
    values = {
        "format": FORMAT,
        "boot": _boot(),
        "config": config_values(record.config),
        "device": record.device,
        "stop_path": str(record.stop_path),
        "simulated": record.simulated,
        "hangs_up": record.hangs_up,
    }
    new = path.with_name(f"{path.name}.new")
    try:
        with os.fdopen(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600), "w") as file:
            json.dump(values, file)
        new.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            new.unlink(missing_ok=True)
            path.unlink(missing_ok=True)
        raise


def read_record(path: Path, socket_path: Path) -> PortRecord | None:
    """Return the record of a killed guard, None if there is none.

    Raises
    ------
    RecordRefused
        If it is of another version, computer start, port or device, or another user can have written it.
    """
    try:
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)) as file:
            found = os.fstat(file.fileno())
            if found.st_uid != os.getuid() or not stat.S_ISREG(found.st_mode) or found.st_mode & 0o077:
                raise RecordRefused("it is open to other users, or is not a file")
            text = file.read(MAX_BYTES + 1)
    except FileNotFoundError:
        return None
    except (OSError, UnicodeError) as error:
        raise RecordRefused(f"it cannot be read: {error}") from error
    if len(text) > MAX_BYTES:
        raise RecordRefused(f"it is larger than {MAX_BYTES} bytes")
    try:
        values = json.loads(text)
        return _checked(values, socket_path)
    except RecordRefused:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise RecordRefused(f"it is of another version: {error!r}") from error


def _checked(values: dict[str, Any], socket_path: Path) -> PortRecord:
    if values["format"] != FORMAT:
        raise RecordRefused(f"its format is {values['format']!r} (expected {FORMAT})")
    config = config_of(values["config"])
    if json.loads(json.dumps(config_values(config))) != values["config"]:
        raise RecordRefused("it has other parameters than this version of the driver")
    if values["boot"] != _boot():
        raise RecordRefused("it was written before the computer's last start")
    if guard_path(config.port) != socket_path:
        raise RecordRefused(f"it is of another port, {config.port}")
    device = tuple(int(number) for number in values["device"])
    try:
        present = device_identity(os.stat(config.port))  # noqa: PTH116 - a port may be a URL, which is no path
    except OSError as error:
        raise RecordRefused(f"{config.port}: {error.strerror}") from error
    if device != present:
        raise RecordRefused(f"another device is at {config.port} now")
    return PortRecord(
        config=config,
        device=device,
        stop_path=Path(values["stop_path"]),
        simulated=bool(values["simulated"]),
        hangs_up=bool(values["hangs_up"]),
    )


def _boot() -> str:
    """Return the kernel's name of the computer's current start."""
    return _BOOT.read_text(encoding="ascii").strip()
