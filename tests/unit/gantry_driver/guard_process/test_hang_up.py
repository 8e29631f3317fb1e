"""DTR at the end of a link: a close in order lowers it if the port was set so, the end of a killed process does not."""

from __future__ import annotations

import os
import pty
import termios
from collections.abc import Iterator

import pytest
from support.deadlines import wait_until

from gantry_driver.adapters.serial_link import SerialLink
from gantry_driver.adapters.serial_port import hang_up
from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.machine.machine import Machine

pytestmark = pytest.mark.slow

WITHIN_S = 10.0


class Port:
    """A pseudo-terminal whose settings the master shows."""

    def __init__(self, hangs_up: bool) -> None:
        self.master, self.slave = pty.openpty()
        self.path = os.ttyname(self.slave)
        hang_up(self.slave, hangs_up)

    @property
    def hangs_up(self) -> bool:
        return bool(termios.tcgetattr(self.master)[2] & termios.HUPCL)

    def link(self, hangs_up: bool | None = None) -> SerialLink:
        made = SerialLink(Machine(DriverConfig(port=self.path)), self.path, 115200, lambda _: None, hangs_up=hangs_up)
        made.start()
        wait_until(lambda: made.hangs_up is not None and made.opened, "the port is open", WITHIN_S)
        return made


@pytest.fixture(params=[True, False])
def port(request: pytest.FixtureRequest) -> Iterator[Port]:
    made = Port(request.param)
    yield made
    os.close(made.master)
    os.close(made.slave)


def test_dtr_stays_high_while_a_link_may_be_killed_and_a_close_restores_the_port(port: Port) -> None:
    before = port.hangs_up
    link = port.link()
    assert not port.hangs_up and link.hangs_up is before
    link.close("the test has ended")
    assert port.hangs_up is before


def test_the_successor_of_a_killed_guard_restores_what_was_set_before(port: Port) -> None:
    before = port.hangs_up
    hang_up(port.slave, False)  # by the guard that was killed
    link = port.link(hangs_up=before)
    link.close("the test has ended")
    assert port.hangs_up is before


def test_what_is_no_terminal_does_not_hang_up() -> None:
    read, write = os.pipe()
    assert not hang_up(read, True)
    os.close(read)
    os.close(write)
