"""Rules for the programs that may send a message; without ROS."""
