# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The assessment of an estimate: each cause gives one warning; and the bounds by default."""

from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.criteria.prediction_error import HORIZONS, Prediction
from pendubot_identification.identification.conventions import Fault
from pendubot_identification.identification.estimate import Effort, Estimate, Zeros
from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.settings import Settings
from pendubot_identification.identification.validation import EXCITATION, assess
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import NAMES, PAPER, Parameters, default_bounds
from pendubot_identification.model.simulation import quantised, simulate
from test.virtual import held_torques

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


def test_divergent_predictions_are_no_error_of_an_exact_rig():
    """Balanced upright, a rig falls in every open-loop simulation, whatever its parameters."""
    size = np.ones((len(HORIZONS), 4))
    divergent = replace(GOOD, prediction=Prediction(3 * size, size, np.full(len(HORIZONS), 9)))
    assert assess(divergent, SETTINGS).level is Level.ERROR
    assert assess(replace(divergent, exact=True), SETTINGS).warnings == ()


@pytest.mark.parametrize(
    ('name', 'estimate', 'beginning', 'level'),
    [
        ('delay', AT_END, 'the delay of the effort lies at -0.1000 s', Level.ERROR),
        ('zero', replace(GOOD, zeros=OFF), "swing: q1's zero is off by 8.0", Level.WARN),
    ],
)
def test_a_fault_replaces_the_warning_that_it_explains(name, estimate, beginning, level):
    """A wrong zero that the estimate contains is no error."""
    (warning,) = assess(estimate, SETTINGS).warnings
    assert warning.startswith(beginning)
    fault = Fault(name, 'found', 'remedy')
    assert assess(estimate, SETTINGS, [fault]).warnings == (fault.sentence,)
    severe = assess(estimate, SETTINGS, [replace(fault, level=Level.ERROR)])
    consequences = (warning,) if level is Level.ERROR else ()
    assert (severe.level, severe.warnings, severe.consequences) == (level, (fault.sentence,), consequences)


def test_a_zero_inertia_gives_one_warning():
    zero = replace(GOOD, theta=PAPER.vector() * [1, 0, 0, 1, 1, 1, 1], free=np.arange(7) != 1)
    warnings = assess(zero, SETTINGS).warnings
    assert [text for text in warnings if 'P2' in text or 'M(q)' in text] == ['not physical: P2 = 0 is not positive']


def test_wide_bounds_make_no_estimate_unphysical():
    wide = replace(SETTINGS, bounds=SETTINGS.bounds.replaced('P1', 0.0, 1e5))
    assert assess(GOOD, wide).warnings == assess(GOOD, SETTINGS).warnings


@pytest.mark.parametrize(
    ('changes', 'beginning'),
    [
        ({'condition_number': 1e6}, 'ill-conditioned'),
        ({'condition_number': 1e6, 'std_error': PAPER.vector()}, 'poorly determined'),
        (
            {'theta': PAPER.vector() * [1, 1, 1, 0, 0, 1, 1], 'free': abs(np.arange(7) - 3.5) > 1},
            'the 95 % intervals of P4 and P5 reach 0: grav',
        ),
    ],
)
def test_each_cause_gives_one_warning(changes, beginning):
    (text,) = assess(replace(GOOD, **changes), SETTINGS).warnings
    assert text.startswith(beginning)


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


#: Links of 1 m, 20 and 10 kg, and of 20 cm, 100 and 50 g, with the same ratio of friction to torque.
LARGE = Parameters(17.0, 3.3, 5.0, 20.0, 5.0, b1=2.0, b2=0.4, Fc1=6.0, Fc2=1.0)
SMALL = Parameters(0.0034, 0.00067, 0.001, 0.02, 0.005, b1=0.0009, b2=0.0002, Fc1=0.006, Fc2=0.001)


def motion(rig):
    return quantised(simulate(rig, np.arange(1200) * 0.01, held_torques(1200, 20, 9.81 * rig.P4, 1)), 4000)


@pytest.fixture(scope='module')
def large():
    return motion(LARGE)


def test_default_bounds_are_scaled_to_the_rig_by_powers_of_ten(large):
    upper = default_bounds().upper
    box = Settings().of_rig([large]).bounds
    # The elbow has no motor, hence no friction under load; k1 has no unit, hence no scale.
    np.testing.assert_array_equal(box.upper, [*(100 * upper[:12]), upper[12], 0.0])
    np.testing.assert_array_equal(box.lower, np.zeros(14))
    np.testing.assert_array_equal(Settings().of_rig([motion(SMALL)]).bounds.upper[:12], upper[:12])


def test_given_bounds_are_kept(large):
    given = default_bounds().replaced('P1', 0.0, 3.0).replaced('b2', 0.4, 0.4).replaced('Fc1', 0.0, 2.0)
    box = Settings(bounds=given).of_rig([large]).bounds
    assert dict(zip(box.names, box.upper, strict=True)).items() >= {'P1': 3.0, 'b2': 0.4, 'Fc1': 2.0}.items()
    assert (box.lower[6], box.upper[3]) == (0.4, 500.0)


def test_a_rig_beyond_the_default_bounds_is_identified(large):
    settings = Settings(('energy', 'weak'), 'coulomb', optimizer='mde', hold='zero', runs=2)
    found = identify([large], (), settings)
    for estimate in found.estimates:
        np.testing.assert_allclose(estimate.theta[:5], LARGE.vector()[:5], rtol=0.02)
        assert not any('lies on its bound' in warning for warning in estimate.warnings)
    assert found.level is Level.OK
