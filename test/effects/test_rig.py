# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The simulated rig with effects is the package's model where it has none."""

import numpy as np

from pendubot_identification.model.dynamics import accelerations as of_package
from pendubot_identification.model.parameters import NAMES

from .rig import TRUE, accelerations


def test_without_effects_it_is_the_model():
    rng = np.random.default_rng(1)
    q1, q2, v1, v2, tau = rng.normal(size=(5, 100)) * [[2.0], [2.0], [5.0], [5.0], [0.3]]
    theta = [*(TRUE[name] for name in NAMES[:5]), 0.0, 0.0]
    np.testing.assert_allclose(
        accelerations(q1, q2, v1, v2, tau, 0.0), of_package(theta, q1, q2, v1, v2, tau, 0.0), rtol=1e-10
    )
