"""Sockets and files; no rclpy."""
