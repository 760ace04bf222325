"""Random but physical pendubots and states, for property tests."""

import numpy as np
from hypothesis import strategies as st

from pendubot_identification.model.dynamics import GRAVITY
from pendubot_identification.model.parameters import MODELS, Parameters


@st.composite
def physical_parameters(draw, model=None):
    """Parameters of a rig that could be built, of one model or any.

    From masses, lengths and inertias, not from P1 .. P5 themselves; dry friction in proportion to the links' weight.
    """
    mass, length, fraction = st.floats(0.05, 3.0), st.floats(0.05, 0.8), st.floats(0.2, 1.0)
    m1, m2, l1, l2 = draw(mass), draw(mass), draw(length), draw(length)
    d1, d2 = draw(fraction) * l1, draw(fraction) * l2
    i1, i2 = m1 * l1**2 * draw(st.floats(0.02, 0.3)), m2 * l2**2 * draw(st.floats(0.02, 0.3))
    viscous, dry, load = st.floats(0.0, 0.05), st.floats(0.0, 0.05), st.floats(0.0, 0.5)
    P2, P4, P5 = m2 * d2**2 + i2, m1 * d1 + m2 * l1, m2 * d2
    weights = GRAVITY * (P4 + P5), GRAVITY * P5
    theta = [m1 * d1**2 + m2 * l1**2 + i1, P2, m2 * l1 * d2, P4, P5, draw(viscous), draw(viscous)]
    size = MODELS[model or draw(st.sampled_from(list(MODELS)))]
    if size >= 9:
        theta += [draw(dry) * weight for weight in weights]
    if size >= 10:
        theta.append(draw(st.floats(0.0, 2.0)) * P2)
    if size >= 14:
        theta += [*(draw(dry) * weight for weight in weights), draw(load), draw(load)]
    return Parameters.from_vector(theta)


def pairs(bound):
    value = st.floats(-bound, bound)
    return st.tuples(value, value).map(np.array)


angles = pairs(7.0)
velocities = pairs(20.0)
torques = pairs(5.0)
