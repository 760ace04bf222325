# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Lengths, masses and inertias of links with given parameters, for simulators.

P1 to P5 leave two of the links' seven numbers free. P3 / P5 is the length l1 of link 1. Any m2 between P5^2 / P2 and
P1 / l1^2, and any m1 above (P4 - m2 l1)^2 / (P1 - m2 l1^2), gives positive inertias and the same motion.
"""

import math
from dataclasses import astuple, dataclass, replace

from pendubot_identification.errors import ParameterError
from pendubot_identification.model.parameters import Parameters


@dataclass(frozen=True, slots=True)
class Link:
    """A link: length [m], mass [kg], distance of the centre of mass from the joint [m], inertia about it [kg m^2]."""

    length: float
    mass: float
    centre: float
    inertia: float


@dataclass(frozen=True, slots=True)
class Rig:
    """Both links, their parameters, and sentences on the choices."""

    first: Link
    second: Link
    parameters: Parameters
    choices: tuple[str, ...]


def rig_of(parameters: Parameters, link_length: float | None = None) -> Rig:
    """Return a rig with these parameters; parameters of two equal uniform rods give these rods.

    ``link_length`` is the measured length of link 1 [m], and P3 becomes P5 times it; None: P3 / P5.

    Raises:
        ParameterError: no real masses give these parameters.
    """
    p = Parameters(*map(float, astuple(parameters)))
    if problems := p.unphysical():
        raise ParameterError(f'no rig has these parameters: {problems[0]}; identify the rig again')
    if link_length is None:
        if not p.P3 * p.P5 > 0:
            found = f'P3 = {p.P3:.4g} and P5 = {p.P5:.4g}'
            raise ParameterError(f'{found} give link 1 no length P3 / P5 above 0; measure it and add --link-length')
        l1 = p.P3 / p.P5
        chosen = f'link 1 is {l1:.6g} m long: P3 / P5'
    else:
        l1, limit = float(link_length), math.sqrt(p.P1 * p.P2) / abs(p.P5) if p.P5 else math.inf
        if not 0 < l1 < limit:
            below = f' and below sqrt(P1 P2) / |P5| = {limit:.4g} m' if p.P5 else ''
            raise ParameterError(
                f'no real masses give these parameters with a link 1 of {l1:g} m; a length above 0{below} is expected'
            )
        p = replace(p, P3=p.P5 * l1)
        chosen = f'link 1 is {l1:.6g} m long, as given: P3 is P5 l1 = {p.P3:.6g} kg m^2, not {parameters.P3:.6g}'
    low, high = p.P5**2 / p.P2, p.P1 / l1**2
    # Two equal uniform rods have this geometric mean, and an m1 of 3/4 inertia / l1^2 above its lower limit.
    m2 = math.sqrt(low * high) or high / 2
    moment, inertia, second = p.P4 - m2 * l1, p.P1 - m2 * l1**2, p.P2 - p.P5**2 / m2
    if not min(inertia, second) > 0:
        raise ParameterError(f'P1 P2 = {p.P1 * p.P2:.17g} exceeds P3^2 by rounding alone; identify the rig again')
    least, more = moment**2 / inertia, 0.75 * inertia / l1**2
    m1 = least + more
    # The length of link 2 is only drawn; a uniform rod has this length.
    l2 = min(1.5 * p.P2 / abs(p.P5), 3 * l1) if p.P5 else l1
    choices = (
        chosen,
        f'm2 = {m2:.6g} kg and m1 = {m1:.6g} kg are chosen: with any m2 from {low:.4g} to {high:.4g} kg, and with this '
        f'm2 any m1 above {least:.4g} kg, the rig moves in the same way',
        f'link 2 is drawn {l2:.4g} m long; its motion does not depend on this length',
    )
    return Rig(Link(l1, m1, moment / m1, inertia * more / m1), Link(l2, m2, p.P5 / m2, second), p, choices)
