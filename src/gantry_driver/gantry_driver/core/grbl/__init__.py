"""GRBL's protocol: messages of the board (``grbl_messages``), lines and answers (``session``).

A session uses ``lines`` (a line and its outcome), ``buffers`` (the board's free space), ``contradictions`` (reports
that contradict the count of answers), ``report_requests``, and ``modes`` (the answer to ``$G``). ``trajectory_gcode``
writes a path as lines, ``trajectory_bytes`` limits a message before it is decoded, and ``settings_profile`` compares
the board's settings.
"""
