"""A dry run on the board: its own parser and soft limits check every line in ``$C`` mode, and nothing moves."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence

import serial

ANSWER_WITHIN_S = 5.0


class CheckFailed(Exception):
    """The board did not do what a GRBL in check mode does; the message says what."""


def dry_run(
    port_name: str, baud: int, lines: Sequence[str], on_line: Callable[[int], None] = lambda number: None
) -> Iterator[tuple[int, int]]:
    """Send lines in check mode, one by one, and yield (index, error number) of each that the board refuses.

    The board is unlocked for it and left as after a reset, so it must be homed anew.

    Parameters
    ----------
    on_line
        Called with the number of lines done.

    Raises
    ------
    CheckFailed
        When the board does not answer, does not enter the mode, or raises an alarm (a soft limit does).
    serial.SerialException
        When the port cannot be opened, for example because another program has it.
    """
    with serial.Serial(port_name, baud, timeout=0.1, exclusive=True) as port:
        _read_until(port, lambda line: line.startswith("Grbl"), "no banner: is it a GRBL board?")
        try:
            for command in ("$X", "$C"):
                if (answer := _ask(port, command)) != "ok":
                    raise CheckFailed(f"{command} was answered by {answer}")
            for number, line in enumerate(lines):
                answer = _ask(port, line)
                if answer.startswith("ALARM"):
                    raise CheckFailed(f"line {line!r}: {answer}")
                if answer != "ok":
                    yield number, int(answer.partition(":")[2])
                on_line(number + 1)
        finally:
            # Leaves check mode, whatever was answered, and empties the buffer.
            port.write(b"\x18")
            port.flush()


def _ask(port: serial.Serial, line: str) -> str:
    port.write(line.encode("ascii") + b"\n")
    return _read_until(
        port, lambda text: text == "ok" or text.startswith(("error:", "ALARM:")), f"no answer to {line!r}"
    )


def _read_until(port: serial.Serial, wanted: Callable[[str], bool], missing: str) -> str:
    end, buffer = time.monotonic() + ANSWER_WITHIN_S, b""
    while time.monotonic() < end:
        buffer += port.read_until(b"\n")
        if buffer.endswith(b"\n"):
            text, buffer = buffer.decode("ascii", "replace").strip(), b""
            if wanted(text):
                return text
    raise CheckFailed(f"{missing} within {ANSWER_WITHIN_S:g} s")
