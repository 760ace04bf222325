# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Runs the firmware's Linux program in place of ``virtual_board``, with the same options."""

import os
import sys
from pathlib import Path

PROGRAM = Path(__file__).parents[2] / 'firmware/build/pendubot_board'

if __name__ == '__main__':
    os.execv(PROGRAM, [str(PROGRAM), *sys.argv[1:]])
