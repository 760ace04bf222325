"""Mathematics and bytes: no input or output, no clock, no thread, no log, no ROS."""
