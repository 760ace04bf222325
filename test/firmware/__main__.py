# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The fault trials on the firmware as a Linux program: ``python -m test.firmware [--short] [NAME ...]``."""

import sys

from test import processes
from test.faults.__main__ import main

from .building import made

made('host')
processes.MODULES['virtual_board'] = 'test.firmware.host_board'
sys.exit(main())
