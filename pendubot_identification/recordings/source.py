# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The identity of a recording, as a result names it; this module imports nothing that reads recordings."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Source:
    """A recording, or a part of it, that was used for ``training`` or ``validation``, its ``role``."""

    bag: str
    role: str
    samples: int
    duration: float
    sha256: str
    closed: bool
    taken_as: str = ''  #: the options that a file's own names and units stand for.
