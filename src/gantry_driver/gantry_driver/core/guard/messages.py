"""The frames between the driver's node and the guard: JSON objects of a bounded size.

A frame is four bytes of length, followed by the JSON text. The reader compares the length with its limit before it
keeps a byte of the text, so no frame can delay the guard for long.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass
from typing import Any, get_type_hints

from gantry_driver.core.configuration.machine_config import DriverConfig
from gantry_driver.core.grbl.trajectory_gcode import Waypoint
from gantry_driver.core.states.machine_states import Answered, CloseRequested, Event, Note, Position, StateChanged
from icu_common.core.goals.results import GoalResult, Outcome
from icu_common.core.reasons.message import Message, decoded, encoded

MAX_FRAME_BYTES = 4 * 1024 * 1024
"""Maximum size of a frame in bytes: twice that of 10,000 points, the largest trajectory that ``max_points`` allows."""
_LENGTH = struct.Struct(">I")
_EVENTS: dict[str, type[Event]] = {kind.__name__: kind for kind in (StateChanged, Position, Note, CloseRequested)}


class FrameError(ValueError):
    """The other side sent an invalid frame; the connection must end."""


def frame(message: Mapping[str, Any]) -> bytes:
    """Return a message as bytes; a value that is a text with a code keeps it.

    Raises
    ------
    FrameError
        If the message is too long.
    """
    texts = {key: encoded(value) for key, value in message.items() if isinstance(value, Message)}
    data = json.dumps({**message, **texts}, separators=(",", ":")).encode()
    if len(data) > MAX_FRAME_BYTES:
        raise FrameError(Message("guard.frame_bytes_limit", data=len(data), max_frame_bytes=MAX_FRAME_BYTES))
    return _LENGTH.pack(len(data)) + data


class FrameReader:
    """Collects received bytes and yields whole messages."""

    def __init__(self) -> None:
        self._data = bytearray()

    def feed(self, data: bytes) -> Iterator[dict[str, Any]]:
        """Yield the messages that these bytes complete.

        Raises
        ------
        FrameError
            If a length exceeds the limit, or a text is not a JSON object.
        """
        self._data += data
        while len(self._data) >= _LENGTH.size:
            (length,) = _LENGTH.unpack_from(self._data)
            if length > MAX_FRAME_BYTES:
                raise FrameError(Message("guard.frame_bytes_limit", data=length, max_frame_bytes=MAX_FRAME_BYTES))
            end = _LENGTH.size + length
            if len(self._data) < end:
                return
            text = bytes(self._data[_LENGTH.size : end])
            del self._data[:end]
            try:
                message = json.loads(text)
            except (ValueError, RecursionError) as error:
                raise FrameError(Message("guard.frame_not_json", error=error)) from error
            if not isinstance(message, dict):
                raise FrameError(Message("guard.frame_not_json_object"))
            yield message


def event_values(event: Event) -> list[Any]:
    """Return an event as JSON values."""
    if isinstance(event, Answered):
        return [Answered.__name__, encoded(asdict(event.result))]
    return [type(event).__name__, encoded(asdict(event))]


def event_of(values: Sequence[Any]) -> Event:
    """Return the event of :func:`event_values`."""
    name, content = values[0], decoded(values[1])
    if name == Answered.__name__:
        details = tuple((str(key), str(value)) for key, value in content.pop("details"))
        outcome = Outcome(content.pop("outcome"))
        return Answered(result=GoalResult(outcome=outcome, details=details, **content))
    if name == Position.__name__:
        x, y, z = content["reading_m"]
        return Position(reading_m=(x, y, z), probe=content["probe"])
    if name == StateChanged.__name__:
        codes = tuple((str(key), str(value)) for key, value in content.pop("codes", ()))
        return StateChanged(codes=codes, **content)
    return _EVENTS[name](**content)


def config_values(config: DriverConfig) -> dict[str, Any]:
    """Return a configuration as JSON values."""
    return asdict(config)


def config_of(values: Mapping[str, Any]) -> DriverConfig:
    """Return the configuration of :func:`config_values`, validated."""
    made = _made(DriverConfig, values)
    assert isinstance(made, DriverConfig)
    return made


def _made(kind: Any, values: Mapping[str, Any]) -> Any:
    hints = get_type_hints(kind)
    known = {item.name: values[item.name] for item in fields(kind)}
    return kind(
        **{
            name: _made(hints[name], value)
            if is_dataclass(hints[name])
            else tuple(value)
            if isinstance(value, list)
            else value
            for name, value in known.items()
        }
    )


def waypoint_values(points: Sequence[Waypoint]) -> list[Any]:
    """Return points as JSON values."""
    return [[point.positions_m, point.velocities_m_s, point.time_s] for point in points]


def waypoints_of(values: Sequence[Any]) -> list[Waypoint]:
    """Return the points of :func:`waypoint_values`."""
    return [Waypoint(positions_m=tuple(p), velocities_m_s=tuple(v), time_s=t) for p, v, t in values]
