# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Both ends of the serial link between board and host: bytes and times in; samples, reports and bytes out.

The host's end is ``host``; a program feeds it with the bytes of a ``serial_port``. The board's end is
``virtual_board``; ``pty_server`` serves it on a pseudo-terminal. The other modules open no port and read no clock.
"""
