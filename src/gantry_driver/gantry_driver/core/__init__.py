"""Pure: values in, values out; no rclpy, serial, clock or threads.

Subpackages in reading order, each with a map of its modules. The driver: ``configuration``, ``states``, ``grbl``,
``program``, ``wire``, ``board_faults``, ``envelope``, ``machine`` (start here), ``guard``. The controller: ``contact``,
``motion``, ``job``, ``sight``, ``goals`` (start here). A subpackage imports only subpackages below it: pyproject.toml
has the layers.
"""
