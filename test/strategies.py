# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Random physical pendubots and states for property tests."""

import numpy as np
from hypothesis import strategies as st

from pendubot_identification.model.dynamics import GRAVITY
from pendubot_identification.model.parameters import MODELS, Parameters


def theta(m1, m2, l1, d1, d2, I1, I2, *friction):
    """Return the parameters of two links from masses, lengths and inertias, as numbers or symbols."""
    return [m1 * d1**2 + m2 * l1**2 + I1, m2 * d2**2 + I2, m2 * l1 * d2, m1 * d1 + m2 * l1, m2 * d2, *friction]


@st.composite
def rigs(draw, model=None):
    """Draw the arguments of ``theta`` for a realistic rig; dry friction is proportional to the links' weight."""
    mass, length, fraction = st.floats(0.05, 3.0), st.floats(0.05, 0.8), st.floats(0.2, 1.0)
    m1, m2, l1, l2 = draw(mass), draw(mass), draw(length), draw(length)
    d1, d2 = draw(fraction) * l1, draw(fraction) * l2
    I1, I2 = m1 * l1**2 * draw(st.floats(0.02, 0.3)), m2 * l2**2 * draw(st.floats(0.02, 0.3))
    viscous, dry, load = st.floats(0.0, 0.05), st.floats(0.0, 0.05), st.floats(0.0, 0.5)
    weights = GRAVITY * (m1 * d1 + m2 * l1 + m2 * d2), GRAVITY * m2 * d2
    rig = [m1, m2, l1, d1, d2, I1, I2, draw(viscous), draw(viscous)]
    size = MODELS[model or draw(st.sampled_from(list(MODELS)))]
    if size >= 9:
        rig += [draw(dry) * weight for weight in weights]
    if size >= 10:
        rig.append(draw(st.floats(0.0, 2.0)) * (m2 * d2**2 + I2))
    if size >= 14:
        rig += [*(draw(dry) * weight for weight in weights), draw(load), draw(load)]
    return rig


def physical_parameters(model=None):
    return rigs(model).map(lambda rig: Parameters.from_vector(theta(*rig)))


def pairs(bound):
    value = st.floats(-bound, bound)
    return st.tuples(value, value).map(np.array)


angles = pairs(7.0)
velocities = pairs(20.0)
torques = pairs(5.0)
