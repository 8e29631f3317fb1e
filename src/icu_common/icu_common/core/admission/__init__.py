"""Which programs may send what: the decisions, without ROS."""
