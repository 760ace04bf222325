# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The severity levels of results and diagnoses."""

import math
from enum import IntEnum

#: 95 % confidence interval half-width in standard errors.
NORMAL_95 = 1.96
#: Relative standard error above which a parameter is poorly determined.
POOR = 0.5


class Level(IntEnum):
    """A severity level, with the numbers of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


def number(text: str | None) -> float:
    """Return a value of a status as a number; NaN if it is missing or no number."""
    try:
        return float(text) if text is not None else math.nan
    except ValueError:
        return math.nan
