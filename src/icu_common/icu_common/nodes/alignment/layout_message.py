"""Deviations of controls from their layout as a message."""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Header

from icu_common.core.alignment.layout import ControlDeviation, DeviationCode
from icu_common.core.configuration.text_bounds import plain
from icu_common.nodes.messages.heads import MAX_NAME
from icu_common.nodes.messages.panels import MAX_CONTROLS
from icu_common.nodes.messages.results import diagnostic_status, pairs_of

_KEYS = ("x_mm", "y_mm", "sigma_x_mm", "sigma_y_mm", "limit_mm")


def layout_message(deviations: Mapping[str, ControlDeviation], head: Header) -> DiagnosticArray:
    """Pack deviations: one status for each control, with its name; the message is the code, the rest are values."""
    message = DiagnosticArray(header=head)
    for deviation in deviations.values():
        numbers = (*deviation.offset_mm, *deviation.sigma_mm, deviation.limit_mm)
        values = [("code", deviation.code.value), *((key, f"{n:.4f}") for key, n in zip(_KEYS, numbers))]
        level = {DeviationCode.REFUSED: "error", DeviationCode.CORRECTED: "warn"}.get(deviation.code, "ok")
        message.status.append(diagnostic_status(deviation.name, level, deviation.code.value, values))
    return message


def layout_of_message(message: DiagnosticArray) -> dict[str, ControlDeviation]:
    """Unpack deviations, by the controls' names.

    Raises
    ------
    ValueError
        If a control's values are missing or wrong.
    """
    found = {}
    for status in message.status[:MAX_CONTROLS]:
        name, values = plain(status.name, MAX_NAME), pairs_of(status)
        try:
            x, y, sigma_x, sigma_y, limit = (float(values[key]) for key in _KEYS)
            code = DeviationCode(values["code"])
        except KeyError as error:
            raise ValueError(f"the deviation of {name} has no {error}") from error
        found[name] = ControlDeviation(
            name=name, code=code, offset_mm=(x, y), sigma_mm=(sigma_x, sigma_y), limit_mm=limit
        )
    return found
