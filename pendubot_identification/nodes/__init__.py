# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Thin programs around the core: parameters in, one call, messages out."""

import os

#: The process that started this one, read before anything else is imported, while it is there.
PARENT = os.getppid()
