"""What needs rclpy: parameters, QoS profiles, message conversions, process start and end."""
