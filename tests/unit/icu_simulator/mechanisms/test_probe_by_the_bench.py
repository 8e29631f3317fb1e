"""Bench and mock board in real time: the stylus's switch ends a probing move on the panel that the bench has."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

import pytest
from support.line_socket import LineSocket
from unit.gantry_driver.mock_rig import FREE
from unit.gantry_driver.mock_service import Running, expect, wait_for

from icu_common.core.configuration.config import from_mapping
from icu_common.core.panel.panel_layout import load_layout
from icu_simulator.adapters.bench.simulation import Simulation
from icu_simulator.core.configuration import BenchConfig

pytestmark = pytest.mark.slow

LAYOUT = load_layout(Path(__file__).parents[4] / "config/scopes/dso_bench_4.yaml")
THRESHOLD_MM = 0.3


@pytest.mark.timeout(120)
def test_probing_ends_where_the_spring_closes_the_switch(tmp_path: Path) -> None:
    with contextlib.ExitStack() as stack:
        running = Running(tmp_path, stack, settings=FREE)
        config = from_mapping(
            BenchConfig,
            {
                "motion_socket": str(running.truth_path),
                "test_socket": str(tmp_path / "test.sock"),
                "stylus.switch.enabled": True,
                "stylus.switch.threshold_mm": THRESHOLD_MM,
                "camera.width_px": 160,
                "camera.height_px": 120,
            },
        )
        simulation = Simulation(LAYOUT, config)
        stack.callback(simulation.stop)
        simulation.start()
        port = running.open()
        expect(port, b"help]\r\n")
        truth = LineSocket(tmp_path / "test.sock")
        stack.callback(truth.close)
        wait_for(lambda: truth.ask(do="truth")["board_connected"])
        # The board starts in the middle of the machine, 5 mm down, over the screen.
        port.write(b"G1Z-26F1800\n")
        expect(port, b"ok\r\n")
        port.write(b"G4P0\n")
        expect(port, b"ok\r\n")
        port.write(b"G38.2Z-34F120\n")
        answer = expect(port, b"ok\r\n")
        assert b"ALARM" not in answer
        probed = re.search(rb"\[PRB:[-\d.]+,[-\d.]+,(-[\d.]+):1\]", answer)
        assert probed, answer
        found = truth.ask(do="truth")
        assert found["contact"] == "SCREEN" and found["switch_closed"] is True
        # 2 mm/s: the sample, the way over two sockets and the stop behind it.
        assert THRESHOLD_MM - 0.01 <= found["compression_mm"] < THRESHOLD_MM + 0.4
        port.write(b"?")
        assert b"|Pn:P" in expect(port, b">\r\n")
        port.write(b"G1Z-20F1800\nG4P0\n")
        expect(port, b"ok\r\nok\r\n")
        wait_for(lambda: truth.ask(do="truth")["switch_closed"] is False)

        def open_again() -> bool:
            port.write(b"?")
            return b"|Pn:" not in expect(port, b">\r\n")

        wait_for(open_again)
