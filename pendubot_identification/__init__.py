# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Identification of a pendubot: from the board's bytes to a latched parameter vector."""

from os import environ

from .model import kernel

__version__ = '0.1.0'

kernel.wanted = environ.get('PENDUBOT_KERNEL', 'on') != 'off'
kernel.threads = int(given) if (given := environ.get('PENDUBOT_THREADS', '')).isdecimal() else 0
