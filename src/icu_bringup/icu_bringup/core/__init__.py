"""Pure: values in, values out; no rclpy, serial, clock or threads."""
