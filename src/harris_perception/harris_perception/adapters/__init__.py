"""What touches the world; no rclpy."""
