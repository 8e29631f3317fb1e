"""Opens a board's serial port, locked for other programs, with the levels of its two control lines."""

from __future__ import annotations

import serial


def open_port(port: str, baud: int, *, dtr: bool, rts: bool, timeout_s: float) -> serial.Serial:
    """Return the open port.

    Linux raises both lines while it opens a port; where ``dtr`` or ``rts`` is False, it is lowered right after that.

    Parameters
    ----------
    port, baud
        Device and line rate.
    dtr, rts
        Levels of Data Terminal Ready and Request To Send while the port is open. A pseudo-terminal has neither.
    timeout_s
        Seconds that a read waits for bytes.

    Raises
    ------
    serial.SerialException
        When the port cannot be opened, for example because another program has it.
    """
    made = serial.Serial(None, baud, timeout=timeout_s, exclusive=True)
    made.dtr, made.rts = dtr, rts
    made.port = port
    made.open()
    return made
