# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""How bad it is: what results, the link and the recorder say of themselves."""

from dataclasses import dataclass
from enum import IntEnum

#: Half the width of a 95 % interval in standard errors.
NORMAL_95 = 1.96
#: A standard error above this fraction of the value leaves little of it.
POOR = 0.5


class Level(IntEnum):
    """How bad it is, with the numbers of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """What ``/diagnostics`` says of a program: a level, one or more sentences, and figures by name, as text."""

    level: Level
    message: str
    values: dict[str, str]
