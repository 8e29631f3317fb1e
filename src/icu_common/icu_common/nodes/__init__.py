"""All code that needs rclpy: parameters, QoS profiles, message conversions, process start and end."""
