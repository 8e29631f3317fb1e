"""Contents of the pages: the first message for a new page, and later each part that has changed."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from scope_ui_bridge.core.access import Role
from scope_ui_bridge.core.desk.chosen import Chosen
from scope_ui_bridge.core.desk.state import DeskState
from scope_ui_bridge.core.effects import Broadcast, Effect, Now, SendToViewer
from scope_ui_bridge.core.wire import Refusal

STATE_PERIOD_S = (0.1, 1.0)
_TIP_SEEN_NS = 1_000_000_000
_MAX_LINES = 40  # per tick
_KEPT_LINES = 100  # for engineers who connect later


class StateFeed:
    """Makes the messages about the desk's state, and keeps what the pages have already received.

    Parameters
    ----------
    state, chosen
        State that the pages show.
    title, robot
        Names of instrument and robot.
    """

    def __init__(self, state: DeskState, chosen: Chosen, title: str, robot: str) -> None:
        self._state = state
        self._chosen = chosen
        self._title, self._robot = title, robot
        self._last: tuple[float, dict[str, Any]] = (-math.inf, {})
        self._lines: list[dict[str, Any]] = []
        self._kept_lines: deque[dict[str, Any]] = deque(maxlen=_KEPT_LINES)
        empty: dict[str, Any] = {"facts": {}, "panel": [], "sequence": {}, "recordings": []}
        self._shown = {"limits": self._limits(), **empty}

    def hello(self, viewer: str, by_password: bool) -> dict[str, Any]:
        """Return the first message for a page."""
        state, page = self._state, self._state.pages[viewer]
        selection = self._chosen.selection
        return {
            "type": "hello",
            "boot": state.boot_id,
            "you": {"id": viewer, "name": page.name, "role": page.role.value, "by_password": by_password},
            "title": self._title,
            "robot": self._robot,
            "replay": state.config.replay,
            "facts": state.machine.facts,
            "panel": state.panel.message,
            "sequence": state.sequence.message(),
            "sequences": state.sequence.stored_message(),
            "recordings": state.recordings.message(state.now_s),
            "limits": self._limits(),
            "log": state.log.messages(),
            "console": list(self._kept_lines) if page.role is Role.ENGINEER else [],
            "selection": selection.message() if selection else None,
            "state": self._snapshot_now(),
        }

    def add_line(self, line: dict[str, Any]) -> None:
        """Keep a log line of a program of the graph for the engineers' consoles."""
        if len(self._lines) < _MAX_LINES:
            self._lines.append(line)

    def tick(self, now: Now) -> list[Effect]:
        """Return the log lines, the parts that have changed, and the state if it is due."""
        effects = self._new_lines() + self._changed_parts()
        snapshot = self._snapshot(now)
        fastest, slowest = STATE_PERIOD_S
        age = now.mono_s - self._last[0]
        if age >= slowest or (age >= fastest - 0.01 and snapshot != self._last[1]):
            effects.append(self._sent(snapshot, now))
        return effects

    def state_effect(self, now: Now) -> Broadcast:
        """Return the state at once, as after a change of control."""
        return self._sent(self._snapshot(now), now)

    def _sent(self, snapshot: dict[str, Any], now: Now) -> Broadcast:
        self._last = (now.mono_s, snapshot)
        return Broadcast(message={"type": "state", **snapshot})

    def _new_lines(self) -> list[Effect]:
        lines, self._lines = self._lines, []
        self._kept_lines.extend(lines)
        pages = self._state.pages.engineers() if lines else []
        return [SendToViewer(viewer=viewer, message={"type": "console", "lines": lines}) for viewer in pages]

    def _changed_parts(self) -> list[Effect]:
        state = self._state
        effects: list[Effect] = []
        for kind, key, value in (
            ("limits", "limits", self._limits()),
            ("facts", "facts", dict(state.machine.facts)),
            ("panel", "controls", state.panel.message),
            ("sequence", "sequence", state.sequence.message()),
            ("recordings", "recordings", state.recordings.message(state.now_s)),
        ):
            if value != self._shown[kind]:
                self._shown[kind] = value
                effects.append(Broadcast(message={"type": kind, key: value}))
        return effects

    def _limits(self) -> dict[str, float]:
        config = self._state.config
        return {
            "amber_ms": config.frame_amber_s * 1e3,
            "max_age_ms": config.frame_max_age_s * 1e3,
            "stale_ms": config.frame_stale_s * 1e3,
            "jog_step_mm": config.jog_step_max_m * 1e3,
        }

    def _snapshot(self, now: Now) -> dict[str, Any]:
        state = self._state
        try:
            state.machine.check_recognition(state.scene.camera_from_panel, state.config, now)
            state.sequence.check_idle()
            state.machine.check_ready()
            refusal = None
        except Refusal as why:
            refusal = why.message()
        return self._snapshot_now() | {"refusal": refusal}

    def _snapshot_now(self) -> dict[str, Any]:
        state, lease = self._state, self._state.lease
        return {
            **state.machine.message(),
            "moving": state.moving,
            "stop_cause": state.causes.message(*state.machine.state("driver"), state.machine.reported("driver") or {}),
            "lease": {
                "epoch": lease.epoch,
                "holder": lease.holder,
                "holder_name": state.pages.name_of(lease.holder),
                "requester": lease.requester,
                "requester_name": state.pages.name_of(lease.requester),
            },
            "tip_seen": state.scene.tip_ns > 0 and abs(state.ros_ns - state.scene.tip_ns) < _TIP_SEEN_NS,
            "viewers": len(state.pages),
            "refusal": None,
        }
