"""Messages that come, that came, and that come again."""
