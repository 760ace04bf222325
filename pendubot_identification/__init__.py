"""Identification of a pendubot: from the board's bytes to a latched parameter vector."""

__version__ = '0.1.0'
