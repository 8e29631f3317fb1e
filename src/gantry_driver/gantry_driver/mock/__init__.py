"""A GRBL 1.1h controller board in software, on a pseudo-terminal; it shares no code with the driver.

``serial_line`` carries bytes, ``firmware`` is the board's program and ``settings`` its EEPROM, ``mechanics`` has the
motors and switches, and ``machine`` adds faults. These are pure: time is an argument. ``pty_port``, ``line_socket`` and
``service`` do input and output; ``main`` is the program.

It is deliberately simpler than the firmware:

- Steps are solved in closed form, without the firmware's look-ahead of about 50 ms, which delays the start of a hold.
- Between lines, numbers are doubles; they are read, stored and printed as 32-bit floats, and none exceeds their range.
- An axis with 0 steps per mm or no acceleration, by which the firmware divides, moves extremely slowly.
- It has no parking, line numbers, single-axis homing or laser mode (``$32`` is only stored).
- Each axis has one limit switch, at its home end.
"""
