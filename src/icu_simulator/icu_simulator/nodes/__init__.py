"""Thin ROS nodes: convert, call core, publish."""

from icu_common.adapters.processes.program_end import starts_in_one_line

starts_in_one_line()
