"""The ``pendubot`` command line: the same work without ROS."""
