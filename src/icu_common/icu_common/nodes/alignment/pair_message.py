"""The state of the camera pair as a message."""

from __future__ import annotations

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Header

from icu_common.core.alignment.pair import PairCode, PairState
from icu_common.core.geometry.geometry import Array
from icu_common.nodes.messages.heads import stamp_ns
from icu_common.nodes.messages.results import diagnostic_status, pairs_of

NAME = "camera_pair"


def pair_message(state: PairState, head: Header) -> DiagnosticArray:
    """Pack the state: one status, whose message is the code, the rest are values; the stamp is that of the pair."""
    values = [
        ("code", state.code.value),
        ("rotation_rad", _numbers(state.rotation_rad)),
        ("sigma_rad", _numbers(state.sigma_rad)),
        ("turn_deg", repr(float(state.turn_deg))),
        ("turn_px", f"{state.turn_px:.3f}"),
        ("limit_deg", repr(float(state.limit_deg))),
        ("focal_px", repr(float(state.focal_px))),
        ("baseline_m", repr(float(state.baseline_m))),
    ]
    level = {PairCode.ALIGNED: "ok", PairCode.CORRECTED: "ok", PairCode.MOVED: "error"}.get(state.code, "warn")
    return DiagnosticArray(header=head, status=[diagnostic_status(NAME, level, state.code.value, values)])


def pair_of_message(message: DiagnosticArray) -> PairState:
    """Unpack the state.

    Raises
    ------
    ValueError
        If the message is something else.
    """
    if len(message.status) != 1 or message.status[0].name != NAME:
        raise ValueError("not the state of the camera pair")
    values = pairs_of(message.status[0])
    try:
        return PairState(
            code=PairCode(values["code"]),
            rotation_rad=_array(values["rotation_rad"]),
            sigma_rad=_array(values["sigma_rad"]),
            turn_deg=float(values["turn_deg"]),
            limit_deg=float(values["limit_deg"]),
            focal_px=float(values["focal_px"]),
            baseline_m=float(values["baseline_m"]),
            stamp_ns=stamp_ns(message.header.stamp),
        )
    except KeyError as error:
        raise ValueError(f"the state of the camera pair has no {error}") from error


def _numbers(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _array(text: str) -> Array:
    return np.array([float(part) for part in text.split()])
