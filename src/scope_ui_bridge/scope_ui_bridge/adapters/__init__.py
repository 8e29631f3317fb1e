"""Connections of the desk to the world; they know no ROS.

``web`` serves the pages and ``video`` their images. ``graph_port`` is the interface to the graph, ``stop_path`` the
path of a stop, and ``mailbox`` the transfer from the executor's thread. ``secret_files`` and ``audit_writer`` write to
the disk, ``recorder`` starts recordings, and ``tasks`` keeps the event loop's tasks.
"""
