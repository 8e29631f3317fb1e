"""State of the machine and its images as received by the desk, and checks whether it permits an action."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

from icu_common.core.geometry.geometry import Transform
from icu_common.core.reasons.codes import StateReports
from icu_common.core.reasons.state_text import split_state
from scope_ui_bridge.core import wire
from scope_ui_bridge.core.config import BridgeConfig
from scope_ui_bridge.core.effects import Now
from scope_ui_bridge.core.wire import Refusal

_MOST_AHEAD_S = 0.1
_POSITION_LIFE_S = 1.0
_EXTENDED_M = 0.0005
"""Minimum extension at which the stylus may press something."""
_MOVING = {
    "driver": {"moving", "homing"},
    "controller": {"moving", "looking", "touching"},
    "calibration": {"calibrating"},
    "sequencer": {"step"},
}


class MachineView:
    """Newest states, confidence of the recognition, position of the tip, and stamps of the shown images."""

    def __init__(self) -> None:
        self._states = dict.fromkeys(_MOVING, "")
        self._reports = {part: StateReports() for part in _MOVING}
        self._confidence = math.nan
        self._confidence_s = -math.inf
        self._position: tuple[float, float, float] | None = None
        self._position_s = -math.inf
        self._frames: dict[str, deque[int]] = {camera: deque(maxlen=90) for camera in wire.CAMERAS}
        self._picture_s = -math.inf
        self.facts: dict[str, dict[str, str]] = {}
        self._moving_since_s = math.inf
        self._simulation_factor: float | None = None

    # --- reports of the graph --------------------------------------------------------------------------------------

    def set_state(self, part: str, text: str) -> None:
        """Set the state of a ``part`` (driver, controller, calibration or sequencer), as on its state topic."""
        self._states[part] = text

    def text(self, part: str) -> str:
        """Return a part's state as on its state topic."""
        return self._states[part]

    def state(self, part: str) -> tuple[str, str]:
        """Return a part's state and its reason."""
        text = self._states[part]
        return split_state(self._reports[part].message_of(text))

    def set_confidence(self, confidence: float, now: Now) -> None:
        """Set the recognition's confidence, 0 = not recognised."""
        self._confidence, self._confidence_s = confidence, now.graph_s

    def set_position(self, x_m: float, y_m: float, stylus_m: float, now: Now) -> None:
        """Set the tip's position: x, y in base_link, the stylus's extension; metres."""
        self._position, self._position_s = (x_m, y_m, stylus_m), now.graph_s

    def expire(self, now: Now) -> None:
        """Discard a position that is no longer reported."""
        if now.graph_s - self._position_s > _POSITION_LIFE_S:
            self._position = None

    @property
    def position(self) -> tuple[float, float, float] | None:
        """Position of the tip as in :meth:`set_position`; None while unknown or not reported."""
        return self._position

    def set_facts(self, part: str, facts: dict[str, str]) -> None:
        """Set the names and values that a part reports about itself."""
        self.facts = {**self.facts, part: facts}

    def set_simulation_factor(self, factor: float) -> None:
        """Set the ratio of simulated to wall time."""
        self._simulation_factor = factor

    def picture_came(self, now: Now) -> None:
        """Record that a camera has delivered an image."""
        self._picture_s = now.graph_s

    def frame_offered(self, camera: str, stamp_ns: int) -> None:
        """Record that pages may have received the image with this stamp, in any form."""
        if stamp_ns not in self._frames[camera]:
            self._frames[camera].append(stamp_ns)

    @property
    def active(self) -> bool:
        """Whether a part of the graph reports that it moves."""
        return any(self.state(part)[0] in names for part, names in _MOVING.items())

    def blind_s(self, now: Now) -> float:
        """Return the seconds since the last image during a motion that started with images.

        Zero while nothing moves, and for a motion that started without images: homing needs none.
        """
        if not self.active:
            self._moving_since_s = math.inf
            return 0.0
        self._moving_since_s = min(self._moving_since_s, now.graph_s)
        silence_s = now.graph_s - self._picture_s
        return silence_s if silence_s < now.graph_s - self._moving_since_s + 1.0 else 0.0

    def set_report(self, part: str, text: str, values: Mapping[str, str], message: str) -> None:
        """Set the codes and values that a part has reported with the text of a state; ``message`` is this text."""
        self._reports[part].take(text, values, message)

    def reported(self, part: str) -> Mapping[str, str] | None:
        """Return the code and its values that a part has reported with its state, None if not yet."""
        return self._reports[part].values_of(self._states[part])

    # --- checks ----------------------------------------------------------------------------------------------------

    def check_frame(self, camera: str, stamp_ns: int, config: BridgeConfig, now: Now) -> None:
        """Refuse unless the image was shown and is recent: ``frame_unknown``, ``frame_old``, ``frame_ahead``."""
        if stamp_ns not in self._frames[camera]:
            raise Refusal("frame_unknown", stamp=str(stamp_ns))
        age_s = (now.ros_ns - stamp_ns) / 1e9
        if age_s < -_MOST_AHEAD_S:  # stamped by another computer's clock: its age is unknown
            raise Refusal("frame_ahead", ahead_ms=round(-age_s * 1e3), limit_ms=round(_MOST_AHEAD_S * 1e3))
        if age_s > config.frame_max_age_s:
            raise Refusal("frame_old", age_ms=round(age_s * 1e3), limit_ms=round(config.frame_max_age_s * 1e3))

    def check_recognition(self, pose: Transform | None, config: BridgeConfig, now: Now) -> Transform:
        """Return the panel's pose; refuse if it is unknown, or if the recognition is silent or not confident enough."""
        if pose is None or math.isnan(self._confidence):
            raise Refusal("panel_not_seen")
        silence_s = now.graph_s - self._confidence_s
        if silence_s > config.recognition_max_age_s:
            raise Refusal("recognition_silent", age_s=round(silence_s, 1), limit_s=config.recognition_max_age_s)
        if not self._confidence >= config.min_confidence:
            raise Refusal(
                "low_confidence", confidence=round(self._confidence, 2), limit=round(config.min_confidence, 2)
            )
        return pose

    def check_ready(self) -> None:
        """Refuse unless the controller accepts gestures: ``no_controller``, ``not_ready``."""
        state, reason = self.state("controller")
        if not state:
            raise Refusal("no_controller")
        if state != "ready":
            raise Refusal("not_ready", state=state, reason=reason)

    def check_still(self) -> None:
        """Refuse while a part of the graph reports that it moves: ``not_at_rest``."""
        for part, names in _MOVING.items():
            state, reason = self.state(part)
            if state in names:
                raise Refusal("not_at_rest", state=state, reason=reason)

    def unrest(self) -> str:
        """Return the reason why safety settings must not change now; empty at rest with the stylus up."""
        for part, names in _MOVING.items():
            if self.state(part)[0] in names:
                return f"the {part} is {self._states[part]!r}"
        extended_m = self._position[2] if self._position else 0.0
        return f"the stylus is extended by {1e3 * extended_m:.1f} mm" if extended_m > _EXTENDED_M else ""

    def check_at_rest(self) -> None:
        """Refuse a move unless the machine is homed, enabled and at rest: ``not_at_rest``."""
        state, reason = self.state("driver")
        if state != "idle":
            raise Refusal("not_at_rest", state=state or "disconnected", reason=reason)
        self.check_still()

    def message(self) -> dict[str, Any]:
        """Return the message for the page."""
        states = {part: dict(zip(("state", "reason"), self.state(part))) for part in self._states}
        position = None
        if self._position and all(math.isfinite(value) for value in self._position):
            position = [round(value * 1e3, 2) for value in self._position]
        return {
            **states,
            "confidence": None if math.isnan(self._confidence) else round(self._confidence, 2),
            "position_mm": position,
            # In tenths, because smaller changes are not worth a message.
            "simulation_factor": None if self._simulation_factor is None else round(self._simulation_factor, 1),
        }
