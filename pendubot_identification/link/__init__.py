# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The wire between board and host, both ends: bytes and the time in; samples, reports and bytes out.

The host's end is ``host``, which a program feeds from a ``serial_port``; the board's is ``virtual_board``, which
``pty_server`` serves on a pseudo-terminal. All others know neither a port nor a clock: bytes and times are arguments.
"""
