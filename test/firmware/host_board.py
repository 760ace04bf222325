# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The firmware as a Linux program, in the place of ``virtual_board``, with its options."""

import os
import sys
from pathlib import Path

PROGRAM = Path(__file__).parents[2] / 'firmware/build/pendubot_board'

if __name__ == '__main__':
    os.execv(PROGRAM, [str(PROGRAM), *sys.argv[1:]])
