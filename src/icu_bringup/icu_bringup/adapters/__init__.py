"""Access to processes, files and sockets; no rclpy."""
