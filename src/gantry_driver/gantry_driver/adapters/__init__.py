"""Input and output: serial port, processes, sockets and files; no rclpy."""
