"""Input and output: sockets, files, processes, threads; no rclpy."""
