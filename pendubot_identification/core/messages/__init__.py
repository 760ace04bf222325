"""Messages that come, and that came."""
