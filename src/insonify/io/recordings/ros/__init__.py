"""ROS bags and messages, version 1 and 2, without ROS."""
