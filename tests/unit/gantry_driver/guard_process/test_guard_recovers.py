"""A guard in one process with its test: what it does with a record, and when it writes and deletes its own."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from unit.gantry_driver.guard_rig import Rig, pressing, states

from gantry_driver.adapters.guard import server as server_module
from gantry_driver.adapters.guard.places import guard_path, stylus_path
from gantry_driver.adapters.guard.port_record import PortRecord, device_identity, read_record, record_path
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.states.machine_states import Note
from icu_common.adapters.direct_stop.line import send_stop

pytestmark = pytest.mark.slow


@pytest.fixture
def port(tmp_path: Path) -> Iterator[Path]:
    """A file in place of a device: its identity can be read."""
    path = tmp_path / "none"
    path.write_text("")
    yield path
    record_path(guard_path(str(path))).unlink(missing_ok=True)
    stylus_path(str(path)).unlink(missing_ok=True)


def record_of(port: Path, **values: Any) -> PortRecord:
    config = DriverConfig(port=str(port), node_silence_s=0.2)
    given = {"config": config, "device": (), "stop_path": port.with_name("stop"), "simulated": False, **values}
    given.setdefault("hangs_up", False)
    return PortRecord(**given)


@pytest.mark.parametrize("down", ["down\n", "up\n", ""])
def test_a_guard_with_a_record_has_a_link_before_a_node_connects(
    make: Callable[..., Rig], port: Path, down: str
) -> None:
    if down:
        stylus_path(str(port)).write_text(down)
    rig = make()
    rig.guard.recover(record_of(port))
    machine = rig.guard._machine
    assert machine is not None and machine.left_moving and not machine.enabled
    assert machine.may_be_down is (down == "down\n")
    assert send_stop(port.with_name("stop"), "the page")


def test_the_node_that_connects_next_gets_the_link_and_sets_its_configuration(
    make: Callable[..., Rig], port: Path
) -> None:
    rig = make()
    rig.guard.recover(record_of(port))
    link, machine = rig.guard._link, rig.guard._machine
    node = rig.node()
    rig.turn()
    rig.hello(node, config=DriverConfig(port=str(port), node_silence_s=0.3))
    assert rig.guard._link is link and machine is not None and machine.config.node_silence_s == 0.3
    assert machine.enabled and states(rig.received(node))


def test_simulated_time_goes_on_without_a_node(make: Callable[..., Rig], port: Path) -> None:
    rig = make()
    rig.guard.recover(record_of(port, simulated=True))
    assert rig.guard._clock.simulated
    begin = rig.guard._clock()
    rig.turn()
    assert rig.guard._clock() > begin


def test_a_record_is_written_for_each_device_and_configuration_and_deleted_at_an_end_in_order(
    make: Callable[..., Rig], port: Path
) -> None:
    rig = make()
    node = rig.node()
    rig.turn()
    config = DriverConfig(port=str(port))
    rig.hello(node, config=config)
    path = record_path(guard_path(str(port)))
    rig.turn()
    assert not path.exists(), "no port has been opened"
    link, machine = rig.guard._link, rig.guard._machine
    assert link is not None and machine is not None
    link.opened = port.stat()
    rig.turn()
    found = read_record(path, guard_path(str(port)))
    assert found == record_of(port, config=config, device=device_identity(port.stat()))
    written = path.stat()
    rig.turn()
    assert path.stat().st_ino == written.st_ino, "nothing has changed"
    machine.config = DriverConfig(port=str(port), lift_on_stop=False)
    rig.turn()
    changed = read_record(path, guard_path(str(port)))
    assert changed is not None and not changed.config.lift_on_stop
    rig.guard._close("the test has ended")
    assert not path.exists()


def test_a_link_whose_thread_has_ended_leaves_its_record_for_the_next_guard(
    make: Callable[..., Rig], port: Path
) -> None:
    rig = make()
    rig.guard.recover(record_of(port))
    assert rig.guard._link is not None
    rig.guard._link.close("replaced")
    path = record_path(guard_path(str(port)))
    path.write_text("")
    pressing(rig).alive = False
    rig.guard._close("the guard is ending")
    assert path.exists()


def test_a_record_that_cannot_be_written_is_reported_once(
    make: Callable[..., Rig], port: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, record: PortRecord) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(server_module, "write_record", full)
    rig = make()
    rig.guard.recover(record_of(port))
    assert rig.guard._link is not None
    rig.guard._link.opened = port.stat()
    rig.turn(3)
    notes = [event.text for event in rig.guard._kept if isinstance(event, Note)]
    assert notes == ["cannot write the record of the open port: [Errno 28] No space left on device"]
