"""A GRBL 1.1h controller board in software, behind a pseudo-terminal; shares no code with the driver.

``serial_line`` carries bytes, ``firmware`` is the board's program and ``settings`` its EEPROM, ``mechanics`` has the
motors and switches, ``machine`` adds faults. These are pure: time is an argument. ``pty_port``, ``line_socket`` and
``service`` touch the world; ``main`` is the program.

Simpler than the firmware, on purpose:

- Steps are solved in closed form; the firmware's look-ahead of about 50 ms (a hold begins that much later) is absent.
- Between lines numbers are doubles; they are read, stored and printed as 32-bit floats, and none is larger.
- An axis with 0 steps per mm or no acceleration, by which the firmware divides, hardly moves.
- Built without parking, line numbers, single-axis homing and laser mode (``$32`` is only stored).
- Each axis has one limit switch, at its home end.
"""
