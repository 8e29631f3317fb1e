"""Pure: values in, values out; no rclpy, sockets, clock or threads.

Subpackages in reading order, each with a map of its modules:

- ``config`` and ``effects``: values of all others
- ``wire``: messages of pages
- ``admission`` and ``access``: rules for connections, and sign-in
- ``control``: the right to move the machine
- ``status``: reports of the graph
- ``records``: command log and audit
- ``video``: image and overlay
- ``orders``: selections and lessons
- ``desk``: decisions

A subpackage imports only subpackages before it, by the names that their ``__init__`` exports.
"""
