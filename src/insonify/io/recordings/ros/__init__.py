"""ROS bags and messages, version 1 and 2, without ROS."""

from insonify.extras import require

require("recordings", "ROS bags and MCAP", "mcap", "rosbags", "zstandard", "apsw")
