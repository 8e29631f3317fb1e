"""The bench in simulated time: a step begins when the graph has finished the one before, at most at real speed."""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nodes.small_bench import LAYOUT_FILE, SMALL

from icu_common.adapters.frame_link import FRAMES, FrameClient
from icu_common.adapters.steps.step_ledger import BYTES_READ, BYTES_WRITTEN, StepLedger
from icu_common.core.configuration.config import ConfigError, from_mapping
from icu_common.core.panel.panel_layout import load_layout
from icu_simulator.adapters.bench.simulation import Simulation
from icu_simulator.adapters.bench.step_time import SERIAL_PATIENCE_S, StepTime
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.nodes.bench_node import BenchNode

PERIOD_NS = 80_000_000
STEP_NS = 20_000_000
DEADLINE_S = 30.0


@pytest.fixture
def ledgers(tmp_path: Path) -> Iterator[tuple[StepLedger, StepLedger]]:
    """The bench's row and that of a node, which subscribes to the images."""
    bench, node = StepLedger(tmp_path / "steps"), StepLedger(tmp_path / "steps")
    bench.register()
    node.register()
    yield bench, node
    bench.close()
    node.close()


def wait_for(condition: Any, what: str = "") -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, f"never so: {what}"
        select.select([], [], [], 0.002)


@dataclass
class SteppedBench:
    """A bench with a stepped board that the test plays, and the times that were published."""

    simulation: Simulation
    steps: StepTime
    published: list[int]
    camera: FrameClient


class SteppedBoard:
    """Answers each step as the mock board does, with the sample of a slow motion, or of rest."""

    def __init__(self, path: Path) -> None:
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(os.fspath(path))
        self._listener.listen(1)
        self.sent = self.received = 0
        self.state = "Run"
        self.until: list[float] = []
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        link, _ = self._listener.accept()
        with link, link.makefile("rwb") as lines:
            for line in lines:
                until_s = json.loads(line)["until"]
                self.until.append(until_s)
                place = [-300.0 + min(until_s, 10.0), -110.0, -5.0]
                sample = {"t": until_s, "mpos": place, "spindle": 0.0, "coolant": False, "state": self.state}
                answer = {"until": until_s, "sent": self.sent, "received": self.received}
                lines.write(f"{json.dumps(sample)}\n{json.dumps(answer)}\n".encode())
                lines.flush()

    def close(self) -> None:
        self._listener.close()


@pytest.fixture
def board(tmp_path: Path) -> Iterator[SteppedBoard]:
    board = SteppedBoard(tmp_path / "truth")
    yield board
    board.close()


@contextlib.contextmanager
def stepped_bench(folder: Path, ledger: StepLedger) -> Iterator[SteppedBench]:
    values = {**SMALL, "layout": str(LAYOUT_FILE), "frame_socket": str(folder / "frames")}
    values |= {"motion_socket": str(folder / "truth"), "camera.rate_hz": 12.5, "stepped": True}
    published: list[int] = []
    steps = StepTime(ledger, STEP_NS, published.append)
    simulation = Simulation(load_layout(LAYOUT_FILE), from_mapping(BenchConfig, values), steps, ledger)
    camera = FrameClient(folder / "frames")
    simulation.start()
    yield SteppedBench(simulation, steps, published, camera)
    camera.close()
    simulation.stop()


@pytest.fixture
def stepped(tmp_path: Path, ledgers: tuple[StepLedger, StepLedger], board: SteppedBoard) -> Iterator[SteppedBench]:
    with stepped_bench(tmp_path, ledgers[0]) as bench:
        yield bench


def test_time_stands_still_until_the_images_have_been_processed(
    stepped: SteppedBench, ledgers: tuple[StepLedger, StepLedger]
) -> None:
    _, node = ledgers
    node.subscribe(FRAMES)
    for _ in range(2):  # the first may have been sent before
        stepped.camera.read(DEADLINE_S)
        node.finish_all(FRAMES)
    stamps = []
    for _ in range(4):
        _, (stamp_ns, _), _ = stepped.camera.read(DEADLINE_S)
        stamps.append(stamp_ns)
        count = len(stepped.published)
        select.select([], [], [], 0.05)  # several steps, if nothing held them up
        # An image arrives one period after its exposure.
        assert len(stepped.published) == count and 0 <= stepped.published[-1] - stamp_ns - PERIOD_NS <= STEP_NS
        node.finish(FRAMES)
    assert set(np.diff(stamps)) == {PERIOD_NS}, "12.5 images in each simulated second, whatever the wall's"
    assert stamps[0] >= stepped.steps.start_ns


def test_steps_follow_each_other_at_most_at_real_speed(stepped: SteppedBench) -> None:
    stepped.camera.close()  # a camera that does not read would hold up the time
    wait_for(lambda: len(stepped.published) > 5)
    begin_s, first = time.monotonic(), len(stepped.published)
    wait_for(lambda: len(stepped.published) >= first + 25)
    wall_s, simulated_s = time.monotonic() - begin_s, (len(stepped.published) - first) * STEP_NS / 1e9
    assert simulated_s <= wall_s + 0.15, "of a delay at most a tenth of a second is made up for"
    assert set(np.diff(stepped.published)) == {STEP_NS}
    assert 0.0 < stepped.simulation.health().factor <= 1.0


def test_factor_falls_while_a_process_is_slow(stepped: SteppedBench, ledgers: tuple[StepLedger, StepLedger]) -> None:
    _, node = ledgers
    node.subscribe(FRAMES)
    begin_s = time.monotonic()
    while time.monotonic() < begin_s + 1.0:  # a quarter of the images that real time has
        stepped.camera.read(DEADLINE_S)
        select.select([], [], [], 0.3)
        node.finish(FRAMES)
    assert 0.0 < stepped.simulation.health().factor < 0.6


def test_images_of_a_moment_are_the_same_on_a_slow_computer(tmp_path: Path) -> None:
    """Motion, screen and noise depend on the simulated time alone, not on when and whether images are read."""
    series: list[dict[float, bytes]] = []
    for name, pause_s in (("free", 0.0), ("busy", 0.12)):
        (tmp_path / name).mkdir()
        board = SteppedBoard(tmp_path / name / "truth")
        bench, node = StepLedger(tmp_path / name / "steps"), StepLedger(tmp_path / name / "steps")
        bench.register()
        node.register()
        node.subscribe(FRAMES)
        images: dict[float, bytes] = {}
        with stepped_bench(tmp_path / name, bench) as running:
            while len(images) < 20:
                pair, (stamp_ns, _), _ = running.camera.read(DEADLINE_S)
                images[round((stamp_ns - running.steps.start_ns) / 1e9, 6)] = b"".join(one.tobytes() for one in pair)
                select.select([], [], [], pause_s)
                node.finish_all(FRAMES)
        board.close()
        node.close()
        bench.close()
        series.append(images)
    common = sorted(set(series[0]) & set(series[1]))
    assert len(common) >= 15
    assert len({series[0][moment] for moment in common}) == len(common), "the stylus moves, and each has its noise"
    assert [series[0][moment] == series[1][moment] for moment in common] == [True] * len(common)


def test_step_waits_for_bytes_on_the_serial_line(
    stepped: SteppedBench, board: SteppedBoard, ledgers: tuple[StepLedger, StepLedger]
) -> None:
    _, driver = ledgers
    wait_for(lambda: len(board.until) > 3, "the board is not advanced")
    board.sent += 12
    wait_for(lambda: len(set(board.until[-3:])) == 1, "the same step is asked for again")
    count = len(stepped.published)
    driver.finish(BYTES_READ, 12)
    wait_for(lambda: len(stepped.published) > count + 2, "the time goes on")
    driver.finish(BYTES_WRITTEN, 7)
    wait_for(lambda: len(set(board.until[-3:])) == 1)
    count = len(stepped.published)
    board.received += 7
    wait_for(lambda: len(stepped.published) > count + 2)


def test_steps_are_as_long_as_the_images_period_while_the_machine_rests(
    stepped: SteppedBench, board: SteppedBoard
) -> None:
    stepped.camera.close()
    image_ns = 80_000_000

    def last_steps(count: int) -> set[int]:
        return set(np.diff(stepped.published[-count - 1 :]).tolist())

    wait_for(lambda: len(stepped.published) > 10)
    assert last_steps(8) == {STEP_NS}, "it moves"
    board.state = "Idle"
    wait_for(lambda: last_steps(4) == {image_ns}, "rest")
    board.received += 1
    count = len(stepped.published)
    wait_for(lambda: len(stepped.published) > count + 3)
    assert last_steps(3) == {image_ns}, "a status request is no order"
    board.received += 12
    wait_for(lambda: last_steps(8) == {STEP_NS}, "an order: short steps before the machine moves")
    wait_for(lambda: last_steps(4) == {image_ns}, "nothing came of it")


def test_bytes_that_no_end_takes_count_as_discarded(ledgers: tuple[StepLedger, StepLedger]) -> None:
    """Opening a port discards what has come before."""
    bench, driver = ledgers
    steps = StepTime(bench, STEP_NS, lambda _: None)
    assert steps.serial_settled(0, 0)
    driver.finish(BYTES_READ, 3)
    begin_s = time.monotonic()
    wait_for(lambda: steps.serial_settled(5, 0))
    assert time.monotonic() - begin_s >= SERIAL_PATIENCE_S
    driver.finish(BYTES_READ, 2)
    assert not steps.serial_settled(8, 0)
    driver.finish(BYTES_READ, 1)
    assert steps.serial_settled(8, 0)


def test_board_is_followed_step_by_step(stepped: SteppedBench, board: SteppedBoard) -> None:
    wait_for(lambda: len(board.until) > 20)
    steps = np.diff(sorted(set(board.until)))
    assert np.abs(steps - STEP_NS / 1e9).max() < 1e-6
    assert stepped.simulation.health().board_connected


def test_time_goes_on_from_where_it_was_when_the_bench_is_restarted(ledgers: tuple[StepLedger, StepLedger]) -> None:
    bench, _ = ledgers
    first = StepTime(bench, STEP_NS, lambda _: None)
    for _ in range(5):
        first.advance(first.now_ns + 10 * STEP_NS)
    assert bench.time_ns == first.now_ns == first.start_ns + 5 * STEP_NS
    second = StepTime(bench, STEP_NS, lambda _: None)
    assert (second.now_ns, second.now_s) == (first.now_ns, first.now_s), "the board has not been restarted"


def test_time_of_images_is_published_with_the_step_that_ends_at_one(ledgers: tuple[StepLedger, StepLedger]) -> None:
    steps_ns: list[int] = []
    images_ns: list[int] = []
    steps = StepTime(ledgers[0], STEP_NS, steps_ns.append, images_ns.append)
    first_ns = steps.now_ns + round(2.5 * STEP_NS)
    for _ in range(3):
        steps.advance(first_ns)
    steps.advance(first_ns + 4 * STEP_NS, long=True)
    assert len(steps_ns) == 4
    assert images_ns == [first_ns, first_ns + 4 * STEP_NS] == steps_ns[2:]


def test_stepped_bench_without_a_ledger_is_refused(ros: Any, tmp_path: Path) -> None:
    settings = {"layout": str(LAYOUT_FILE), "stepped": True}
    with pytest.raises(ConfigError, match=r"stepped needs a ledger of steps \(ICU_STEP_LEDGER\), which bring_up makes"):
        ros.node(BenchNode, settings)
