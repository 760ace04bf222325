"""What is minimised, and the exact minimum where there is one."""
