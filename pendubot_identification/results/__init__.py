"""A result as a file: written, read again, and handed to other programs."""
