"""A mock board whose time a simulation advances."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from unit.gantry_driver.mock_rig import FREE
from unit.gantry_driver.mock_service import Running, expect, wait_for

from icu_simulator.adapters.bench.motion_client import MotionClient


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Running]:
    with contextlib.ExitStack() as stack:
        yield Running(tmp_path, stack, stepped=True, settings=FREE)


@pytest.fixture
def bench(running: Running) -> Iterator[MotionClient]:
    client = MotionClient(running.truth_path)
    assert client.connect()
    yield client
    client.close()


def test_board_moves_only_as_far_as_its_time_is_advanced(running: Running, bench: MotionClient) -> None:
    port = running.open()
    wait_for(lambda: running.control.ask(do="state")["open"] is True)
    bench.advance(1.0)
    expect(port, b"help]\r\n")
    before_mm = running.control.ask(do="state")["mpos"][0]
    port.write(b"G1X-10F600\n")
    wait_for(lambda: bench.advance(1.0) == [] and bench.received == 11)
    start_mm = running.control.ask(do="state")["mpos"][0]
    assert start_mm == before_mm, "bytes take time on the line"
    samples = bench.advance(1.5)
    assert samples[-1].time_s == pytest.approx(1.5, abs=1e-9)
    assert -5.0 < samples[-1].mpos_mm[0] - start_mm < -4.0, "10 mm/s for almost half a second"
    assert running.control.ask(do="state")["mpos"][0] == samples[-1].mpos_mm[0]
    assert bench.advance(4.0)[-1].mpos_mm[0] - start_mm == -10.0


def test_samples_of_a_motion_are_of_the_same_moments_each_time(tmp_path: Path) -> None:
    found = []
    for attempt in range(2):
        with contextlib.ExitStack() as stack:
            folder = tmp_path / str(attempt)
            folder.mkdir()
            running = Running(folder, stack, stepped=True, settings=FREE)
            client = MotionClient(running.truth_path)
            assert client.connect()
            stack.callback(client.close)
            port = running.open()
            wait_for(lambda: running.control.ask(do="state")["open"] is True)  # noqa: B023
            client.advance(1.0)
            port.write(b"G1X-3Y-2F900\n")
            wait_for(lambda: not client.advance(1.0) and client.received == 13)  # noqa: B023
            found.append([sample for step in range(60) for sample in client.advance(1.0 + (step + 1) / 60)])
    assert found[0] == found[1]
    moving = [b.time_s - a.time_s for a, b in zip(found[0], found[0][1:]) if a.mpos_mm != b.mpos_mm]
    assert len(moving) > 20 and max(moving) < 0.0051


def test_bytes_are_counted_in_both_directions(running: Running, bench: MotionClient) -> None:
    port = running.open()
    wait_for(lambda: running.control.ask(do="state")["open"] is True)
    bench.advance(1.0)
    banner = expect(port, b"help]\r\n")
    assert bench.sent == len(banner) and bench.received == 0
    port.write(b"?")
    wait_for(lambda: bench.advance(1.0) == [] and bench.received == 1)
    bench.advance(1.2)
    assert bench.sent == len(banner) + len(expect(port, b">\r\n"))


def test_faults_last_as_long_as_the_board_s_time(running: Running, bench: MotionClient) -> None:
    running.fault("unplug", seconds=2.0)
    bench.advance(1.9)
    assert running.control.ask(do="state")["port"] is None
    bench.advance(2.1)
    assert running.control.ask(do="state")["port"] is not None


def test_board_that_has_gone_is_found_out(running: Running, bench: MotionClient) -> None:
    running.service.stop()
    wait_for(lambda: (bench.advance(1.0), bench.socket is None)[1])


def test_stepped_board_needs_who_advances_it(start_without_truth: Callable[[], None]) -> None:
    with pytest.raises(ValueError, match="a stepped board needs a truth socket"):
        start_without_truth()


@pytest.fixture
def start_without_truth() -> Callable[[], None]:
    from gantry_driver.mock.machine import MockMachine
    from gantry_driver.mock.service import Service
    from gantry_driver.mock.settings import make_eeprom

    return lambda: Service(MockMachine(make_eeprom({})), stepped=True).run()
