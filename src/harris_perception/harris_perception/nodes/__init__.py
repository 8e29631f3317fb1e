"""Thin ROS nodes: convert, call core, publish."""
