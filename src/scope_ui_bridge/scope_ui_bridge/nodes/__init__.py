"""Thin ROS nodes: convert, call core, publish.

Start with ``bridge_node``. ``graph_outlets`` has its publishers and services, ``scene_inlets``, ``machine_inlets``,
``shown_topics`` and ``program_watch`` its subscriptions, made by ``checked_subscription`` and stamped by ``arrival``.
``bridge_files`` reads its files, and ``simulated_clock`` detects that simulated time has stopped.
``foxglove_sidecar`` is a program of its own.
"""

from icu_common.adapters.processes.program_end import starts_in_one_line

starts_in_one_line()
