"""Motions: as they were recorded, filtered, in pieces, as splines."""
