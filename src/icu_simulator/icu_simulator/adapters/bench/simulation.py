"""Runs the bench in its own thread: motor samples in, stereo pairs out, ground truth to the log and to tests."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from icu_common.adapters.steps.step_gate import PATIENCE_S
from icu_common.adapters.steps.step_ledger import StepLedger
from icu_common.core.configuration.config import from_mapping, to_mapping
from icu_common.core.geometry.geometry import Transform
from icu_common.core.panel.panel_layout import PanelLayout
from icu_simulator.adapters.bench.board_link import BoardLink
from icu_simulator.adapters.bench.image_drawing import ImageDrawing, stamps_ns
from icu_simulator.adapters.bench.image_output import ImageOutput
from icu_simulator.adapters.bench.request_socket import RequestSocket
from icu_simulator.adapters.bench.step_time import StepTime
from icu_simulator.adapters.bench.truth_log import TruthLog
from icu_simulator.core.bench import Bench, matrix
from icu_simulator.core.configuration import BenchConfig
from icu_simulator.core.renderer import Renderer
from icu_simulator.core.touch import check_keys
from icu_simulator.imaging.rig import CameraShift
from icu_simulator.imaging.stream import CameraStream
from icu_simulator.imaging.timing import shots

EXPOSURE_LAG_S = 0.015
"""Seconds by which the exposure is in the past, so that the motor samples around it have arrived."""
STEP_LOOK_MIN_S, STEP_LOOK_MAX_S = 0.0005, 0.004
"""Shortest and longest interval between two checks whether a step is finished."""
_LOOK_SHARE = 0.2
"""Interval between two checks as a share of the time waited so far."""


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Health:
    """Values of the simulation for the diagnostics."""

    board_connected: bool
    frames_sent: int
    readers: int
    render_ms: float
    bad_lines: int
    error: str
    factor: float
    left_behind: str


class Simulation:
    """The bench, in real time or in steps.

    Parameters
    ----------
    layout
        The panel.
    config
        The bench, with the paths of its sockets and of the truth log.
    steps
        Simulated clock; None for real time.
    ledger
        Ledger that counts the images of a stepped bench; None for real time.

    Raises
    ------
    OSError
        If a socket or the log cannot be created.
    ValueError
        If the configuration does not fit together.
    """

    def __init__(
        self,
        layout: PanelLayout,
        config: BenchConfig,
        steps: StepTime | None = None,
        ledger: StepLedger | None = None,
    ) -> None:
        self._layout = layout
        self._config = config
        self._steps = steps
        self._bench = Bench(layout, config)
        self._renderer = Renderer(layout, config, self._bench.panel_from)
        self._stream = CameraStream()
        self._drawing = ImageDrawing(self._stream)
        self._images = ImageOutput(Path(config.frame_socket) if config.frame_socket else None, ledger)
        self._render_s = 0.0
        self._error = ""
        self._hidden: tuple[float, float, float, float] | None = None
        self._jobs: deque[BenchConfig] = deque()
        self._stopping = False
        self._selector = selectors.DefaultSelector()
        self._wake_read, self._wake_write = socket.socketpair()
        self._wake_read.setblocking(False)
        self._wake_write.setblocking(False)
        self._selector.register(self._wake_read, selectors.EVENT_READ, self._woken)
        self._board = BoardLink(
            Path(config.motion_socket) if config.motion_socket else None, self._bench, self._selector
        )
        self._requests: RequestSocket | None = None
        self._log: TruthLog | None = None
        try:
            self._open()
        except OSError:
            self._close()
            raise
        self._thread = threading.Thread(target=self._run, name="bench", daemon=True)

    def _open(self) -> None:
        config = self._config
        self._images.open()
        if config.test_socket:
            self._requests = RequestSocket(Path(config.test_socket), self._selector, self._answer)
        if config.truth_log:
            self._log = TruthLog(Path(config.truth_log))

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and remove the sockets; may be called twice."""
        self._stopping = True
        self._wake()
        if self._thread.is_alive():
            self._thread.join(10.0)

    def check(self, config: BenchConfig) -> None:
        """Raise :class:`ConfigError` if a configuration does not fit the panel; from any thread."""
        check_keys(config.keys, self._layout)

    def configure(self, config: BenchConfig) -> None:
        """Apply another configuration; from any thread."""
        self._jobs.append(config)
        self._wake()

    def health(self) -> Health:
        """Return numbers for the diagnostics; from any thread."""
        steps = self._steps
        return Health(
            board_connected=self._board.connected,
            frames_sent=self._images.sent,
            readers=self._images.readers,
            render_ms=self._render_s * 1000,
            bad_lines=self._board.bad_lines,
            error=self._error,
            factor=1.0 if steps is None else steps.factor(),
            left_behind="" if steps is None else ", ".join(f"{one.program} ({one.topic})" for one in steps.left_behind),
        )

    def _wake(self) -> None:
        # OSError: the thread has closed everything already, or is being woken anyway.
        with contextlib.suppress(OSError):
            self._wake_write.send(b"\0")

    def _woken(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._wake_read.recv(4096)

    def _run(self) -> None:
        try:
            if self._steps is None:
                self._run_in_real_time()
            else:
                self._run_in_steps(self._steps)
        except Exception as error:
            # The node's diagnostics report it; a thread that dies silently would look like a frozen camera.
            self._error = f"the bench has stopped: {error!r}"
            raise
        finally:
            self._close()

    def _run_in_real_time(self) -> None:
        next_frame = time.monotonic()
        while not self._stopping:
            now = time.monotonic()
            due = [next_frame - now]
            due += self._board.retries_in_s(now)
            self._serve(min(due))
            self._board.connect()
            now = time.monotonic()
            if now >= next_frame:
                self._bench.advance(now)
                exposure = now - EXPOSURE_LAG_S
                self._expose(exposure, time.time_ns() - round((time.monotonic() - exposure) * 1e9))
                period = 1 / self._config.camera.rate_hz
                # Keep the period; after a long pause start from now instead of catching up.
                next_frame = next_frame + period if now - next_frame < period else now + period
            else:
                self._images.flush()
            self._write_log()

    def _run_in_steps(self, steps: StepTime) -> None:
        next_frame_ns = steps.now_ns + round(1e9 / self._config.camera.rate_hz)
        while not self._stopping:
            self._board.connect()
            while not self._stopping and (wait_s := steps.wait_s()) > 0:
                self._serve(wait_s)
            steps.advance(next_frame_ns, long=not self._board.is_busy(steps.now_s))
            # Timers and goals of this step come before the reaction of the board and the cameras.
            self._serve_until(steps.settled)
            self._board.follow(steps.now_s)
            self._bench.advance(steps.now_s)
            if steps.now_ns >= next_frame_ns:
                self._expose_in_steps(steps.now_s, steps.now_ns)
                next_frame_ns += round(1e9 / self._config.camera.rate_hz)
            given_up_s = time.monotonic() + PATIENCE_S
            self._serve_until(lambda: self._images.flush() or time.monotonic() > given_up_s)  # noqa: B023
            self._serve_until(lambda: self._board_settled(steps))
            self._write_log()

    def _serve(self, timeout_s: float) -> None:
        """Answer the sockets, for at most ``timeout_s``, and apply new configurations."""
        for key, _ in self._selector.select(max(timeout_s, 0.0)):
            key.data()
        while self._jobs:
            self._reconfigure(self._jobs.popleft())

    def _serve_until(self, condition: Callable[[], bool]) -> None:
        """Serve until the condition holds, or the bench must stop; the condition has its own time limits."""
        begin_s = time.monotonic()
        while not self._stopping and not condition():
            waited_s = time.monotonic() - begin_s
            self._serve(min(max(_LOOK_SHARE * waited_s, STEP_LOOK_MIN_S), STEP_LOOK_MAX_S))

    def _board_settled(self, steps: StepTime) -> bool:
        """Whether board, driver and graph have processed everything sent in this step."""
        if not steps.settled():
            return False
        if self._board.connected:
            self._board.follow(steps.now_s)
            if not steps.serial_settled(self._board.sent, self._board.received):
                return False
        return steps.settled()

    def _expose(self, exposure_s: float, stamp_ns: int) -> None:
        begin_s = time.monotonic()
        if not self._images.is_wanted():
            return
        self._renderer.follow_panel(self._bench.panel_from)
        images = self._stream.take(self._config, self._bench, self._renderer, exposure_s)
        if images:  # else both cameras lost their images
            self._images.send(images, stamps_ns(images, exposure_s, stamp_ns))
        self._render_s = time.monotonic() - begin_s

    def _expose_in_steps(self, exposure_s: float, stamp_ns: int) -> None:
        """Send the images of the previous exposure; while the graph processes them, draw those of this one."""
        images, stamps = self._drawing.take()
        if not self._images.is_wanted():
            return
        self._renderer.follow_panel(self._bench.panel_from)
        exposure = self._stream.expose(shots(self._config, exposure_s), self._config, self._bench)
        self._drawing.begin(exposure, self._renderer, exposure_s, stamp_ns)
        if images:
            self._images.send(images, stamps)
            self._render_s = self._drawing.seconds

    def _reconfigure(self, config: BenchConfig) -> None:
        self._drawing.finish()
        self._bench.reconfigure(config)
        old, self._config = self._config, config
        rebuilt = config.camera != old.camera or config.manufacture != old.manufacture
        if rebuilt or config.stylus.still() != old.stylus.still():
            self._renderer = Renderer(self._layout, config, self._bench.panel_from)
            self._renderer.hide(self._hidden)
            return
        if config.imaging != old.imaging:
            self._renderer.reimage(config)
        if config.light != old.light:
            self._renderer.relight(config.light)
        if config.panel != old.panel:
            self._renderer.move_panel(self._bench.panel_from)

    def _write_log(self) -> None:
        records = self._bench.take_records()
        if self._log is None or not records:
            return
        offset = time.time() - time.monotonic() if self._steps is None else self._steps.start_ns / 1e9
        self._log.write(records, offset)

    def _answer(self, line: bytes) -> dict[str, Any]:
        self._write_log()  # the log is then complete up to this truth
        self._drawing.finish()
        try:
            request = json.loads(line)
            if not isinstance(request, dict) or request.get("do") not in self._COMMANDS:
                raise ValueError(f"a mapping with do = one of {', '.join(self._COMMANDS)} is needed")
            return {"ok": True, **(self._COMMANDS[request["do"]](self, request) or {})}
        except (ValueError, KeyError, TypeError, OSError) as error:
            return {"ok": False, "error": str(error) if isinstance(error, ValueError) else repr(error)}

    def _do_truth(self, request: dict[str, Any]) -> dict[str, Any]:
        self._renderer.settle(time.monotonic() - EXPOSURE_LAG_S if self._steps is None else self._steps.now_s)
        rig = self._renderer.rig
        truth = self._bench.truth()
        camera_from_base = rig.rectified_left_from_base()
        if self._config.camera.mounting == "carriage":
            moved = np.array([*truth["carriage_m"], 0.0])
            camera_from_base = camera_from_base @ Transform(np.eye(3), -moved)
        return {
            "t": time.time() if self._steps is None else self._steps.now_ns / 1e9,
            **truth,
            "camera_from_base": matrix(camera_from_base),
            "camera_from_panel": matrix(camera_from_base @ self._bench.panel_from),
            "board_connected": self.health().board_connected,
            "camera": self._images.state,
        }

    def _do_set(self, request: dict[str, Any]) -> None:
        self._reconfigure(from_mapping(BenchConfig, {**to_mapping(self._config), **request["values"]}))

    def _do_hide(self, request: dict[str, Any]) -> None:
        given = request.get("rectangle_mm")
        if given is None:
            self._hidden = None
        else:
            x, y, width, height = (float(v) for v in given)
            if not (width > 0 and height > 0):
                raise ValueError(f"rectangle_mm = {given}: width and height must be positive")
            self._hidden = x, y, width, height
        self._renderer.hide(self._hidden)

    def _do_move_panel(self, request: dict[str, Any]) -> None:
        dx, dy, turn = (float(request.get(key, 0.0)) for key in ("dx_m", "dy_m", "turn_deg"))
        if max(abs(dx), abs(dy)) > 0.1 or abs(turn) > 20:
            raise ValueError(f"dx_m {dx}, dy_m {dy}, turn_deg {turn}: at most 0.1 m and 20 degrees")
        self._bench.move_panel(dx, dy, turn)
        self._renderer.move_panel(self._bench.panel_from)

    def _do_knock(self, request: dict[str, Any]) -> None:
        x, y, z = (float(v) for v in request.get("turn_deg", (0.0, 0.0, 0.0)))
        u, v = (float(v) for v in request.get("lens_px", (0.0, 0.0)))
        if max(abs(x), abs(y), abs(z)) > 5 or max(abs(u), abs(v)) > 100:
            raise ValueError(f"turn_deg {x, y, z}, lens_px {u, v}: limit 5 degrees and 100 px")
        self._renderer.knock(str(request["camera"]), CameraShift(turn_deg=(x, y, z), lens_px=(u, v)))

    def _do_camera(self, request: dict[str, Any]) -> None:
        self._images.set_state(request["state"])

    _COMMANDS: ClassVar[dict[str, Callable[[Simulation, dict[str, Any]], dict[str, Any] | None]]] = {
        "truth": _do_truth,
        "set": _do_set,
        "hide": _do_hide,
        "move_panel": _do_move_panel,
        "knock": _do_knock,
        "camera": _do_camera,
    }

    def _close(self) -> None:
        self._drawing.close()
        self._write_log()
        self._images.close()
        self._board.close()
        if self._requests is not None:
            self._requests.close()
            self._requests = None
        if self._log is not None:
            self._log.close()
            self._log = None
        self._selector.close()
        self._wake_read.close()
        self._wake_write.close()
