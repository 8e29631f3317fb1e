"""A dry run on the board: its own parser and soft limits check every line in ``$C`` mode, and nothing moves."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Sequence

import serial

ANSWER_WITHIN_S = 5.0
BANNER_WAIT_S = 2.5
"""An Arduino is reset by the opening of its port and has then been in its boot loader for up to two seconds."""
UNASKED_S = 0.2
"""For the rest of a line that comes unasked."""
RESET_HINT_S = 1.0
"""After an alarm GRBL hears no reset for half a second, until it asks for one."""
_ANSWER = re.compile(r"ok|error:\d+|ALARM:\d+")


class CheckFailed(Exception):
    """The board did not do what a GRBL in check mode does; the message says what."""


def dry_run(
    port_name: str,
    baud: int,
    lines: Sequence[str],
    on_line: Callable[[int], None] = lambda number: None,
    *,
    before: Sequence[str] = (),
) -> Iterator[tuple[int, int]]:
    """Send lines in check mode, one by one, and yield (index, error number) of each that the board refuses.

    The board is unlocked for it and left as after a reset, so it must be homed anew.

    Parameters
    ----------
    on_line
        Called with the number of lines done.
    before
        Lines that let the board's parser stand, with the modes that it has there, where the program begins.

    Raises
    ------
    CheckFailed
        When the board does not answer, does not enter the mode, or raises an alarm (a soft limit does).
    serial.SerialException
        When the port cannot be opened, for example because another program has it.
    """
    with serial.Serial(port_name, baud, timeout=0.1, exclusive=True) as port:
        _await_reset(port)
        try:
            for command in ("$X", "$C"):
                if (answer := _ask(port, command)) != "ok":
                    raise CheckFailed(f"{command} was answered by {answer}")
            # Whatever has been answered: to a board in another mode the lines would be no dry run.
            port.write(b"?")
            report = _read_line(port, lambda text: text.startswith("<"), ANSWER_WITHIN_S)
            if not report.startswith("<Check"):
                raise CheckFailed(f"after $C the board reports {report or 'nothing'}, <Check is needed")
            for number, line in enumerate((*before, *lines), -len(before)):
                answer = _ask(port, line)
                if answer.startswith("ALARM"):
                    _read_line(port, lambda text: text.startswith("[MSG:Reset"), RESET_HINT_S)
                if answer.startswith("ALARM") or (number < 0 and answer != "ok"):
                    raise CheckFailed(f"line {line!r}: {answer}")
                if number >= 0:
                    if answer != "ok":
                        yield number, int(answer.partition(":")[2])
                    on_line(number + 1)
        finally:
            # Leaves check mode, whatever was answered, and empties the buffer.
            port.write(b"\x18")
            port.flush()


def _await_reset(port: serial.Serial) -> None:
    """Wait for the banner; a board that goes on running when its port is opened is reset, unless it moves."""
    if _read_line(port, _is_banner, BANNER_WAIT_S):
        return
    port.write(b"?")
    report = _read_line(port, lambda text: text.startswith("<"), ANSWER_WITHIN_S)
    if report and not report.startswith(("<Idle", "<Alarm", "<Check")):
        raise CheckFailed(f"a board at rest is needed, this one reports {report}")
    port.write(b"\x18")
    if not _read_line(port, _is_banner, ANSWER_WITHIN_S):
        raise CheckFailed(f"no banner within {ANSWER_WITHIN_S:g} s: is it a GRBL board?")


def _is_banner(text: str) -> bool:
    return text.lower().startswith("grbl")


def _ask(port: serial.Serial, line: str) -> str:
    # A board that has reset itself has left check mode: nothing more may be sent to it.
    if port.in_waiting and _read_line(port, _is_banner, UNASKED_S):
        raise CheckFailed(f"the board was reset by itself before line {line!r}")
    port.write(line.encode("ascii") + b"\n")
    answer = _read_line(port, lambda text: _is_banner(text) or _ANSWER.fullmatch(text) is not None, ANSWER_WITHIN_S)
    if _is_banner(answer):
        raise CheckFailed(f"the board was reset by itself at line {line!r}")
    if not answer:
        raise CheckFailed(f"no answer to {line!r} within {ANSWER_WITHIN_S:g} s")
    return answer


def _read_line(port: serial.Serial, wanted: Callable[[str], bool], within_s: float) -> str:
    """Return the first line that is wanted, empty if none comes in time."""
    end, buffer = time.monotonic() + within_s, b""
    while time.monotonic() < end:
        buffer += port.read_until(b"\n")
        if buffer.endswith(b"\n"):
            text, buffer = buffer.decode("ascii", "replace").strip(), b""
            if wanted(text):
                return text
    return ""
