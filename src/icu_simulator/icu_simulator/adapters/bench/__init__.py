"""The running bench: its thread and its time, its sockets, its images and its log."""
