"""Access to devices, files and sockets; no rclpy."""
