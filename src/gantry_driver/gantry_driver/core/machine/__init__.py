"""The machine as a state machine: start reading at ``machine``; each of its parts is a class above the previous one.

They are ``board_state`` (phase, stylus, goal, published state), ``connection`` (port, firmware), ``board_settings``,
``stopping`` (stops), ``proof`` (reports compared with the path), ``streaming`` (goals), ``homing``, and ``machine``
(time-outs, and the effect of each message of the board). ``attendance`` has the signs of life of a goal's controller,
and ``monitor`` the counts for people.
"""
