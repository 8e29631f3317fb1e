"""The record of an open port: what is kept, and each kind that is refused with its reason."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gantry_driver.adapters.guard import port_record
from gantry_driver.adapters.guard.places import guard_path
from gantry_driver.adapters.guard.port_record import (
    MAX_BYTES,
    PortRecord,
    RecordRefused,
    device_identity,
    read_record,
    record_path,
    write_record,
)
from gantry_driver.core.configuration.machine_config import DriverConfig, StylusConfig

pytestmark = pytest.mark.long


class Place:
    """A port that is a file, its guard's socket path, and the record."""

    def __init__(self, folder: Path) -> None:
        self.port = folder / "port"
        self.port.write_text("")
        self.socket = guard_path(str(self.port))
        self.path = folder / "record"
        config = DriverConfig(port=str(self.port), stylus=StylusConfig(kind="servo_m3"), lift_on_stop=False)
        device = device_identity(self.port.stat())
        self.record = PortRecord(config=config, device=device, stop_path=folder / "stop", simulated=True, hangs_up=True)
        write_record(self.path, self.record)

    def change(self, change: Callable[[dict[str, Any]], object]) -> None:
        values = json.loads(self.path.read_text())
        change(values)
        self.path.write_text(json.dumps(values))

    def refused(self) -> str:
        with pytest.raises(RecordRefused) as found:
            read_record(self.path, self.socket)
        return str(found.value)


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


def test_a_record_is_read_as_it_was_written_and_no_other_user_can_read_it(place: Place) -> None:
    assert read_record(place.path, place.socket) == place.record
    assert place.path.stat().st_mode & 0o777 == 0o600
    assert sorted(p.name for p in place.path.parent.iterdir()) == ["port", "record"], "nothing half-written is left"


def test_there_may_be_no_record(place: Place) -> None:
    place.path.unlink()
    assert read_record(place.path, place.socket) is None


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda v: v.update(format=2), "its format is 2 (expected 1)"),
        (lambda v: v.pop("simulated"), "it is of another version: KeyError('simulated')"),
        (lambda v: v["config"].pop("rts"), "it is of another version: KeyError('rts')"),
        (lambda v: v["config"].update(force_n=1.0), "it has other parameters than this version of the driver"),
        (lambda v: v["config"].update(baud=7), "it is of another version: ConfigError("),
        (lambda v: v["config"]["machine"].update(steps_per_mm=[1.0]), "it is of another version: ConfigError("),
        (lambda v: v.update(boot="another"), "it was written before the computer's last start"),
        (lambda v: v.update(device=[1, 2, 3]), "another device is at "),
        (lambda v: v.update(device=None), "it is of another version: TypeError("),
    ],
)
def test_a_record_of_another_version_start_or_device_is_refused(
    place: Place, change: Callable[[dict[str, Any]], object], reason: str
) -> None:
    place.change(change)
    assert place.refused().startswith(reason)


def test_a_record_of_another_port_is_refused(place: Place) -> None:
    other = place.port.with_name("other")
    other.write_text("")
    place.change(lambda v: v["config"].update(port=str(other)))
    assert place.refused() == f"it is of another port, {other}"


def test_a_record_of_a_device_that_was_replaced_is_refused(place: Place) -> None:
    place.port.rename(place.port.with_name("first"))
    place.port.write_text("")
    assert place.refused() == f"another device is at {place.port} now"


def test_a_record_of_a_device_that_has_gone_is_refused(place: Place) -> None:
    place.port.unlink()
    assert place.refused() == f"{place.port}: No such file or directory"


@pytest.mark.parametrize("mode", [0o640, 0o602])
def test_a_record_that_another_user_may_have_written_is_refused(place: Place, mode: int) -> None:
    place.path.chmod(mode)
    assert place.refused() == "it is open to other users, or is not a file"


def test_a_record_that_is_no_file_is_refused(place: Place) -> None:
    place.path.unlink()
    place.path.symlink_to(place.port)
    assert place.refused().startswith("it cannot be read: ")
    place.path.unlink()
    os.mkfifo(place.path, 0o600)
    assert place.refused() == "it is open to other users, or is not a file"


@pytest.mark.parametrize("text", ["", "{", "[]", "7", "[" * 3000, "\udcff"])
def test_a_record_that_is_damaged_is_refused(place: Place, text: str) -> None:
    place.path.write_bytes(text.encode(errors="surrogateescape"))
    assert place.refused()


def test_a_record_that_is_too_large_is_refused(place: Place) -> None:
    place.path.write_text(" " * (MAX_BYTES + 1))
    assert place.refused() == f"it is larger than {MAX_BYTES} bytes"


def test_a_record_that_cannot_be_written_leaves_no_old_one(place: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(values: object, file: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(port_record.json, "dump", full)
    with pytest.raises(OSError, match="No space left"):
        write_record(place.path, dataclasses.replace(place.record, simulated=False))
    assert [p.name for p in place.path.parent.iterdir()] == ["port"]


def test_each_port_has_its_own_record(place: Place) -> None:
    other = guard_path(str(place.port.with_name("other")))
    assert record_path(place.socket).parent == place.socket.parent and record_path(place.socket) != record_path(other)
