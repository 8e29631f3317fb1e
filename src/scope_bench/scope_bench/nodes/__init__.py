"""Thin ROS nodes: convert, call core, publish."""

from icu_common.adapters.program_end import interrupts_in_one_line

interrupts_in_one_line()
