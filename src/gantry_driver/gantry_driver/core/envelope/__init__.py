"""Where trajectories may go at the panel: its plane, the allowed travel of each intent, the free space above; pure.

``plane`` is the panel's plane as the driver receives it, ``rules`` has the limits of each intent, ``keeper`` applies
them to a path, and ``estimate`` is the controller's estimate of the plane.
"""
