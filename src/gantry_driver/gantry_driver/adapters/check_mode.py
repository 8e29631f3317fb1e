"""A dry run on the board: its own parser and soft limits check every line in ``$C`` mode, and nothing moves."""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Callable, Generator, Sequence

import serial

from gantry_driver.adapters.serial_port import open_port

ANSWER_WITHIN_S = 5.0
BANNER_WAIT_S = 2.5
"""Maximum seconds to wait for a banner: opening the port resets an Arduino, whose boot loader runs for up to 2 s."""
UNASKED_S = 0.2
"""Maximum seconds to wait for the rest of an unrequested line."""
RESET_HINT_S = 1.0
"""Maximum seconds to wait until GRBL requests a reset: for half a second after an alarm it ignores resets."""
BEYOND = "G21G90G53G0X99999"
"""Move to a target twenty times beyond the longest travel that can be configured."""
_ANSWER = re.compile(r"ok|error:\d+|ALARM:\d+")


class CheckFailed(Exception):
    """The board did not behave like GRBL in check mode; the message gives the difference."""


def dry_run(
    port_name: str,
    baud: int,
    lines: Sequence[str],
    on_line: Callable[[int], None] = lambda number: None,
    *,
    before: Sequence[str] = (),
    dtr: bool = True,
    rts: bool = True,
) -> Generator[tuple[int, int]]:
    """Send lines in check mode, one by one, and yield (index, error number) of each one that the board rejects.

    The board is unlocked for the check and left as after a reset; a board that was locked is locked again.

    Parameters
    ----------
    on_line
        Called with the number of checked lines.
    before
        Lines that bring the board's parser to the position and the modes at the program's start.
    dtr, rts
        Levels of the port's control lines.

    Raises
    ------
    CheckFailed
        If the board does not answer, does not enter the mode, raises an alarm (for example a soft limit), or cannot be
        locked again.
    serial.SerialException
        If the port cannot be opened, for example because another program uses it.
    """
    with open_port(port_name, baud, dtr=dtr, rts=rts, timeout_s=0.1) as port:
        _await_reset(port)
        locked = _state(port) == "Alarm"
        try:
            for command in ("$X", "$C"):
                if (answer := _ask(port, command)) != "ok":
                    raise CheckFailed(f"{command} was answered by {answer}")
            # Whatever the answers were: on a board in another mode the lines would be no dry run.
            report = _report(port)
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
            # Leaves check mode, whatever the answers were, and empties the buffer.
            port.write(b"\x18")
            port.flush()
            if locked:
                _lock(port)


def _await_reset(port: serial.Serial) -> None:
    """Wait for the banner; reset a board that does not restart when its port is opened, unless it moves."""
    if _read_line(port, _is_banner, BANNER_WAIT_S):
        return
    report = _report(port)
    if report and not report.startswith(("<Idle", "<Alarm", "<Check")):
        raise CheckFailed(f"a board at rest is needed, this one reports {report}")
    port.write(b"\x18")
    if not _read_line(port, _is_banner, ANSWER_WITHIN_S):
        raise CheckFailed(f"no banner within {ANSWER_WITHIN_S:g} s: is it a GRBL board?")


def _report(port: serial.Serial) -> str:
    port.write(b"?")
    return _read_line(port, lambda text: text.startswith("<"), ANSWER_WITHIN_S)


def _state(port: serial.Serial) -> str:
    return _report(port)[1:].partition("|")[0]


def _lock(port: serial.Serial) -> None:
    """Lock a board again after its reset, as it was before ``$X``, because it has not been homed.

    A target beyond the soft limits causes their alarm in check mode as well, and the lock remains after the reset.
    Nothing moves, and the motors keep their power, which ``$SLP`` would switch off.
    """
    if _read_line(port, _is_banner, ANSWER_WITHIN_S) and _state(port) == "Idle":
        with contextlib.suppress(CheckFailed):
            if _ask(port, "$C") == "ok" and _state(port) == "Check" and _ask(port, BEYOND).startswith("ALARM"):
                _read_line(port, lambda text: text.startswith("[MSG:Reset"), RESET_HINT_S)
        port.write(b"\x18")
        _read_line(port, _is_banner, ANSWER_WITHIN_S)
    if (state := _state(port)) != "Alarm":
        raise CheckFailed(
            f"the board was locked before and could not be locked again: it is {state or 'silent'}, and moves without "
            "having been homed"
        )


def _is_banner(text: str) -> bool:
    return text.lower().startswith("grbl")


def _ask(port: serial.Serial, line: str) -> str:
    # A board that has reset itself has left check mode: no further line may be sent to it.
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
    """Return the first line that is wanted, empty if none arrives in time."""
    end, buffer = time.monotonic() + within_s, b""
    while time.monotonic() < end:
        buffer += port.read_until(b"\n")
        if buffer.endswith(b"\n"):
            text, buffer = buffer.decode("ascii", "replace").strip(), b""
            if wanted(text):
                return text
    return ""
