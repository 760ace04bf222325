"""The bytes between board and host, and the rules of both ends."""
