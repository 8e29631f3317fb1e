"""A goal from its command to its answer: start reading at ``controller``.

``goal_intake`` accepts or rejects a goal; ``goal_run``, ``goal_phases`` and ``contact_phases`` carry it out. ``servo``
corrects a path by a look at the tip, ``touch_checks`` judges what the cameras show of a touch. ``world`` has the latest
inputs, ``obstacles`` and ``panel_obstacles`` the reasons not to start a goal, ``progress`` the progress as text, and
``sequence`` a series of goals.
"""
