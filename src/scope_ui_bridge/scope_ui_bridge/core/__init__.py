"""Pure: values in, values out; no rclpy, sockets, clock or threads.

Subpackages in reading order, each with a map of its modules: ``config`` and ``effects`` (the values of all others),
``wire`` (messages of pages), ``admission`` and ``access`` (who may connect, and sign-in), ``control`` (who may move the
machine), ``status`` (what the graph reports), ``records`` (command log and audit), ``video`` (image and overlay),
``orders`` (selections and lessons), and ``desk``, which decides. A subpackage imports only subpackages before it, by
the names that their ``__init__`` exports.
"""
