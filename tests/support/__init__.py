"""Helpers that tests of several folders share, and benchmarks too; a helper of one folder is next to its tests.

Waiting: ``deadlines`` polls a condition until a deadline. ``ros_rig`` has a private ROS context for nodes, and spins it
until a condition holds.

The whole robot: ``virtual_robot`` runs the cores of all programs on a virtual clock, with the simulated bench and the
mock board. ``line_socket`` asks bench and mock board for the truth, if they run as processes.

Cameras: ``pinhole`` makes camera models, ``camera_chain`` encodes an image in the formats of ordinary cameras.

Files: ``parameter_files`` reads the shipped parameters, ``message_files`` the messages of all languages and the calls
that make them, and ``foreign_bags`` writes bags with the libraries of other projects.

Page: ``page_floods`` floods an operator page's server from a process of its own.
"""
