"""A goal from its command to its answer: start reading at ``controller``.

``controller_messages`` has the events and actions, ``controller_config`` the settings. ``goal_intake`` accepts or
rejects a goal, ``goal_job`` has the state of the goal in progress, ``goal_run`` and ``goal_phases`` carry it out, and
``effects`` evaluates the instrument's reaction. ``world`` has the latest inputs, ``obstacles`` the reasons not to start
a goal, ``patience`` the limits of lateness, ``progress`` the progress as text, and ``sequence`` a series of goals.
"""
