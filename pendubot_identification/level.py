"""How bad it is."""

from enum import IntEnum


class Level(IntEnum):
    """What a result or a link is worth, with the numbers of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
