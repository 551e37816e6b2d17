"""The first bytes of bags, by which they are told without the libraries that read them."""

from __future__ import annotations

MCAP_MAGIC = b"\x89MCAP0\r\n"
ROS1_MAGIC = b"#ROSBAG V"
SQLITE_MAGIC = b"SQLite format 3\0"
