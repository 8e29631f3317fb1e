"""One running graph for many faults: brings the machine into each phase, and makes it ready again."""

from __future__ import annotations

import contextlib
import math
import re
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from matrix.cells import BOARD, GUARD, PROGRAMS
from matrix.page import PageReader
from matrix.witness import Witness
from nodes.guard_rig import guards_of
from std_msgs.msg import String
from support.line_socket import BoardSocket, LineSocket
from support.ros_rig import Ros
from system.conftest import RunningGraph
from system.terminal_operator import Operator

from gantry_driver.core.configuration.machine_config import DriverConfig
from icu_common.core.admission.heartbeats import PROGRAMS as HEARTBEAT_PROGRAMS
from icu_common.nodes import qos

HOLD_S = 6
"""Duration of a hold in contact: three times what a fault may leave the stylus on the panel."""
READY_S = 600.0
REALLY_DOWN_MM = 3.0
TURNED_MM = 1.5
GESTURES = {
    "descent": f"hold:RUN_STOP:{HOLD_S}",
    "contact": f"hold:RUN_STOP:{HOLD_S}",
    "turn": "turn:TIME_SCALE:270",
    "drag": "drag:0.05,0.06@panel_link:0.15,0.06@panel_link",
}


class Stage:
    """The graph, an operator at a terminal, a signed-in page, and the witness of the true position."""

    def __init__(self, folder: Path, domain: int, ros: Ros, *extra: str) -> None:
        programs = f"{HEARTBEAT_PROGRAMS} operator"
        settings = [
            *(f"{node}.heartbeat_programs={programs}" for node in ("serial_driver", "gantry_controller")),
            f"serial_driver.stylus_file={folder}/stylus",
        ]
        given = [text for setting in settings for text in ("--set", setting)]
        self.graph = RunningGraph(folder, domain, *given, *extra)
        self.operator = Operator(ros)
        self._ros = ros
        self.calibration: list[str] = []
        take = lambda m: self.calibration.append(m.data)  # noqa: E731
        self.operator.node.create_subscription(String, "/calibration/state", take, qos.LATCHED)
        home_mm = DriverConfig().machine.homed_mpos_mm()
        run_dir = self.graph.run_dir
        self.witness: Witness | None = None
        self._make_witness = lambda: Witness(
            lambda: BoardSocket(run_dir / "board"), lambda: LineSocket(run_dir / "bench"), home_mm
        )
        self.page: PageReader | None = None
        self._count = 0

    # --- the machine made ready --------------------------------------------------------------------------------------

    def make_ready(self) -> None:
        """Bring the machine to rest, homed, calibrated and enabled, with all programs running.

        Raises
        ------
        TimeoutError
            If that is not so within READY_S.
        """
        end = time.monotonic() + READY_S
        self.operator.subscribe_states()
        self.wait(lambda: set(PROGRAMS) <= set(self.pids()), READY_S, "all programs run")
        while True:
            with ThreadPoolExecutor(max_workers=1) as pool:
                if self.operator.driver_state.startswith(("stopped", "alarm", "mismatch")):
                    self.ask_reset()
                left_s = max(end - time.monotonic(), 5.0)
                done = pool.submit(self.graph.command, "gantry_driver", "gantry_prepare", within_s=left_s)
                self.wait(done.done, left_s + 10.0, "gantry_prepare")
                result = done.result()
            ready = lambda: self.operator.state == "ready" and self.operator.driver_state == "idle"  # noqa: E731
            if result.returncode == 0 and self.holds(ready, 30.0):
                break
            if time.monotonic() > end:
                raise TimeoutError(f"not ready: {result.stdout[-300:]}{result.stderr[-300:]}; {self.operator.state}")
        if self.witness is None:
            self.witness = self._make_witness()
        self.wait(lambda: bool(self.witness and self.witness.samples), 30.0, "the witness sees the machine")
        if self.page is None:
            self.page = PageReader(self.graph.page_address())
        self.operator.wait_until_ready(self.graph.tail)

    def ask_reset(self) -> None:
        with contextlib.suppress(BaseException):
            self.operator.call("/gantry/reset")

    def pids(self) -> dict[str, int]:
        """Return the processes of the graph by the names of their programs."""
        parent, found = self.graph.process.pid, {}
        for child in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
            with contextlib.suppress(OSError):
                line = Path(f"/proc/{child}/cmdline").read_text(errors="replace").replace("\0", " ")
                name = re.search(r"__node:=(\S+)", line)
                found[name[1] if name else BOARD if BOARD in line else line] = int(child)
        for guard in guards_of(self.graph.run_dir / "grbl"):
            found[GUARD] = guard
        return found

    def namespace(self, program: str) -> str:
        """Return the namespace of a program's node."""
        names = self.operator.node.get_node_names_and_namespaces()
        return next((space for name, space in names if name == program), "/")

    # --- waiting -----------------------------------------------------------------------------------------------------

    def holds(self, condition: Callable[[], Any], within_s: float) -> bool:
        """Return whether the condition becomes true; the operator's node is served meanwhile."""
        end = time.monotonic() + within_s
        while not condition():
            if time.monotonic() > end or self.graph.process.poll() is not None:
                return bool(condition())
            self._ros.executor.spin_once(timeout_sec=0.02)
        return True

    def wait(self, condition: Callable[[], Any], within_s: float, what: str) -> None:
        if not self.holds(condition, within_s):
            raise TimeoutError(
                f"{what}: not within {within_s:g} s; {self.operator.state}, {self.operator.driver_state}"
            )

    # --- the phases --------------------------------------------------------------------------------------------------

    def begin(self, phase: str) -> str:
        """Bring the machine into a phase; return the goal's id, empty without a goal."""
        operator, witness = self.operator, self.witness
        assert witness is not None
        if phase == "travel":
            self._go(0.01, 0.01)
            return self._when_moving(operator.move(0.34, 0.2))
        self._go(0.02, 0.02)
        if phase == "homing":
            self.wait(lambda: operator.call("/gantry/home").success, 20.0, "homing is accepted")
            self.wait(lambda: operator.driver_state == "homing", 10.0, "homing")
        elif phase == "calibration":
            self.wait(lambda: operator.call("/calibration/run").success, 20.0, "calibration is accepted")
            self.wait(lambda: self.calibrating and operator.driver_state == "moving", 30.0, "calibrating")
        elif phase != "rest":
            return self._gesture(phase)
        return ""

    @property
    def calibrating(self) -> bool:
        return bool(self.calibration) and self.calibration[-1].startswith("calibrating")

    def _go(self, x_m: float, y_m: float) -> None:
        result = self.operator.answer(self.operator.move(x_m, y_m))
        if result.outcome.value != "reached":
            raise TimeoutError(f"the way to the start: {result.outcome.value} {result.reason}")

    def _when_moving(self, goal: str) -> str:
        self.wait(lambda: self.operator.driver_state == "moving", 15.0, "moving")
        return goal

    def _gesture(self, phase: str) -> str:
        operator, witness = self.operator, self.witness
        assert witness is not None
        self._count += 1
        goal = f"matrix-{time.monotonic_ns()}-{self._count}"
        operator.command.publish(String(data=f"{GESTURES[phase]} id={goal}"))

        def answered() -> bool:
            return any(r.goal_id == goal and r.outcome.final for r in operator.results)

        def reached() -> bool:
            last = witness.last
            if phase == "descent":
                return operator.state == "touching" and last.extension > REALLY_DOWN_MM
            if phase == "contact" or not last.contact:
                return last.contact
            touched = next(s for s in reversed(witness.samples) if not s.contact)
            return math.hypot(last.x - touched.x, last.y - touched.y) > TURNED_MM

        self.wait(lambda: reached() or answered(), 90.0, phase)
        if answered():
            raise TimeoutError(f"{phase}: {[r for r in operator.results if r.goal_id == goal][-1].reason}")
        return goal

    def close(self) -> None:
        if self.witness is not None:
            self.witness.close()
        if self.page is not None:
            self.page.close()
        self.operator.close()
        if self.graph.process.poll() is None:
            self.graph.stop()
