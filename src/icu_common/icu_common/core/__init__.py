"""Pure values: no rclpy, no sockets, no clock."""
