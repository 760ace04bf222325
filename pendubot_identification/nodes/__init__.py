"""Thin programs around the core: parameters in, one call, messages out."""
