# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The assessment of an estimate: each cause gives one warning, and a fault replaces the warnings that it explains."""

from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.identification.assessment import EXCITATION, assess
from pendubot_identification.identification.conventions import Fault
from pendubot_identification.identification.estimate import Effort, Estimate, Zeros
from pendubot_identification.identification.prediction import HORIZONS, Prediction
from pendubot_identification.identification.settings import Settings
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import NAMES, PAPER

SETTINGS = Settings(('weak',), 'viscous', optimizer='lsq')
GOOD = Estimate(
    criterion='weak',
    model='viscous',
    theta=PAPER.vector(),
    free=np.ones(7, dtype=bool),
    covariance=np.diag((1e-3 * PAPER.vector()) ** 2),
    correlation=np.eye(7),
    std_error=1e-3 * PAPER.vector(),
    uncertainty='',
    effort=Effort('zero'),
    J=1e-6,
    residuals=100,
    condition_number=10.0,
    converged=True,
    fixed=np.zeros(7, dtype=bool),
    unexplained=0.01,
    J_exact=1e-6,
    prediction=Prediction(np.ones((len(HORIZONS), 4)), 2 * np.ones((len(HORIZONS), 4)), np.full(len(HORIZONS), 9)),
)
OFF = Zeros(('swing',), np.radians([[8.0], [0.0]]), np.radians([[0.1], [0.1]]))
AT_END = replace(GOOD, effort=Effort('zero', -0.1))


@pytest.mark.parametrize(
    ('name', 'estimate', 'beginning'),
    [
        ('delay', AT_END, 'the delay of the effort lies at -0.1000 s'),
        ('zero', replace(GOOD, zeros=OFF), "swing: q1's zero is off by 8.0"),
    ],
)
def test_a_fault_replaces_the_warning_that_it_explains(name, estimate, beginning):
    (warning,) = assess(estimate, SETTINGS).warnings
    assert warning.startswith(beginning)
    fault = Fault(name, 'found', 'remedy')
    assert assess(estimate, SETTINGS, [fault]).warnings == (fault.sentence,)
    severe = assess(estimate, SETTINGS, [replace(fault, level=Level.ERROR)])
    assert (severe.level, severe.warnings, severe.consequences) == (Level.ERROR, (fault.sentence,), (warning,))


def test_a_zero_inertia_gives_one_warning():
    theta = PAPER.vector() * [1, 0, 0, 1, 1, 1, 1]
    free = np.array([True, False, True, True, True, True, True])
    warnings = assess(replace(GOOD, theta=theta, free=free), SETTINGS).warnings
    assert [text for text in warnings if 'P2' in text or 'M(q)' in text] == ['not physical: P2 = 0 is not positive']


def test_poorly_determined_parameters_give_one_warning():
    ill = replace(GOOD, condition_number=1e6)
    (text,) = assess(ill, SETTINGS).warnings
    assert text.startswith('ill-conditioned')
    (text,) = assess(replace(ill, std_error=PAPER.vector()), SETTINGS).warnings
    assert text.startswith('poorly determined')


def test_a_rig_without_gravity_gives_one_warning():
    theta = PAPER.vector() * [1, 1, 1, 0, 0, 1, 1]
    (text,) = assess(replace(GOOD, theta=theta, free=theta > 0), SETTINGS).warnings
    assert text.startswith('the 95 % intervals of P4 and P5 reach 0: gravity hardly acts')


def test_a_delay_at_the_end_of_its_default_search_interval_is_an_error():
    fixed = replace(GOOD, effort=Effort('zero', 0.1))
    assert assess(AT_END, SETTINGS).level is Level.ERROR
    assert assess(GOOD, SETTINGS).level is Level.OK
    assert assess(AT_END, replace(SETTINGS, delays=(-0.1, 0.01))).level is Level.WARN
    assert assess(fixed, replace(SETTINGS, delays=(0.1, 0.1))).level is Level.OK


@pytest.mark.parametrize(('scale', 'warned'), [(1, False), (0.8, False), (30, True), (0.1, True)])
def test_a_torque_in_another_unit_is_reported_if_the_mass_of_link_2_is_known(scale, warned):
    rod, scaled = 4 / 3 * GOOD.theta[4] ** 2 / GOOD.theta[1], replace(GOOD, theta=scale * GOOD.theta)
    warnings = assess(scaled, replace(SETTINGS, link_mass=rod)).warnings
    assert any(f'{scale * rod:.3g} kg if it is a uniform rod' in warning for warning in warnings) == warned
    assert not any('weighs' in warning for warning in assess(scaled, SETTINGS).warnings)


@pytest.mark.parametrize(
    ('errors', 'expected'),
    [
        ({}, []),
        ({'b2': 0.8, 'P3': 0.3}, ['b2 (standard error 80 % of the value)', 'P3 (standard error 30 % of the value)']),
        ({'b2': np.inf}, ['b2 (not identifiable)']),
        ({'b1': 3.0}, []),
        ({'P2': 0.5}, ['P2 (standard error 50 % of the value, correlation 0.99 with P5)']),
    ],
)
def test_advice_lists_the_worst_parameter_first_with_a_motion_that_excites_it(errors, expected):
    """P2 is correlated with P5, and b1 lies on its bound."""
    correlation, free = np.eye(7), np.array(NAMES[:7]) != 'b1'
    correlation[1, 4] = correlation[4, 1] = 0.99
    std_error = PAPER.vector() * [errors.get(name, 0.01) for name in NAMES[:7]]
    poor = replace(GOOD, correlation=correlation, free=free, std_error=std_error)
    assert list(assess(poor, SETTINGS).advice) == [
        f'the motion is little informative of {text}; to improve: {EXCITATION[text[:2]]}' for text in expected
    ]
