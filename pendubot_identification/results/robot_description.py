# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The description of a pendubot that robot_state_publisher and RViz need: a URDF with the links' lengths."""

from __future__ import annotations

import math
from string import Template

from pendubot_identification.errors import ParameterError
from pendubot_identification.resources import resource

TEMPLATE = 'config/pendubot.urdf.template'
#: A link's radius over the length of the shorter one.
SLENDER = 0.05


def robot_description(l1: float, l2: float) -> str:
    """Return the URDF of a pendubot with links of these lengths [m].

    Raises:
        ParameterError: a length that is no positive number.
    """
    for name, length in (('l1', l1), ('l2', l2)):
        if not (math.isfinite(length) and length > 0):
            raise ParameterError(f'the length {name} is {length:g} m; a number above 0 is expected')
    radius = SLENDER * min(l1, l2)
    values = {'l1': l1, 'l2': l2, 'half_l1': l1 / 2, 'half_l2': l2 / 2, 'radius': radius, 'aside': -2.2 * radius}
    values |= {'motor_radius': 2 * radius, 'motor_length': 4 * radius, 'motor_y': 3.2 * radius}
    return Template(resource(TEMPLATE).read_text(encoding='utf-8')).substitute(
        {name: f'{value:.9g}' for name, value in values.items()}
    )
