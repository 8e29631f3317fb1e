"""Opens a board's serial port, locked for other programs, with the levels of its two control lines."""

from __future__ import annotations

import termios

import serial


def open_port(port: str, baud: int, *, dtr: bool, rts: bool, timeout_s: float) -> serial.Serial:
    """Return the open port.

    Linux raises both lines while it opens a port; a line whose ``dtr`` or ``rts`` is False is lowered right after that.

    Parameters
    ----------
    port, baud
        Device and baud rate.
    dtr, rts
        Levels of Data Terminal Ready and Request To Send while the port is open. A pseudo-terminal has neither.
    timeout_s
        Seconds that a read waits for bytes.

    Raises
    ------
    serial.SerialException
        If the port cannot be opened, for example because another program uses it.
    """
    made = serial.Serial(None, baud, timeout=timeout_s, exclusive=True)
    made.dtr, made.rts = dtr, rts
    made.port = port
    made.open()
    return made


def hang_up(descriptor: int, on: bool) -> bool:
    """Set whether the last close of a port lowers its DTR line; return the previous setting, False without one."""
    try:
        modes = termios.tcgetattr(descriptor)
        before = bool(modes[2] & termios.HUPCL)
        if before is not on:
            modes[2] = modes[2] | termios.HUPCL if on else modes[2] & ~termios.HUPCL
            termios.tcsetattr(descriptor, termios.TCSANOW, modes)
    except (OSError, termios.error):  # a port on the network, or an unplugged device
        return False
    return before
