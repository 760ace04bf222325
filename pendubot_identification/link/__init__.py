"""The wire between board and host, both ends: bytes and the time in; samples, reports and bytes out.

Protocol, clock, host, motor and virtual board know no port and no clock of their own; the serial port and the
pseudo-terminal stand beside them.
"""
