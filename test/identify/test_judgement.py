# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""One sentence for one cause: what a named fault explains is not said again, nor is one failure in two ways."""

from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.identify.diagnosis import Fault
from pendubot_identification.identify.estimate import Effort, Estimate, Zeros
from pendubot_identification.identify.judgement import assess
from pendubot_identification.identify.prediction import HORIZONS, Prediction
from pendubot_identification.identify.settings import Settings
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import PAPER

SETTINGS = Settings(('weak',), 'viscous', optimizer='lsq')
LENGTH = PAPER.P3 / PAPER.P5, 1e-4
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
    held=np.zeros(7, dtype=bool),
    unexplained=0.01,
    J_exact=1e-6,
    prediction=Prediction(np.ones((len(HORIZONS), 4)), 2 * np.ones((len(HORIZONS), 4)), np.full(len(HORIZONS), 9)),
)
OFF = Zeros(('swing',), np.radians([[8.0], [0.0]]), np.radians([[0.1], [0.1]]))


@pytest.mark.parametrize(
    ('name', 'estimate', 'length', 'doubt'),
    [
        ('delay', replace(GOOD, effort=Effort('zero', 0.1)), LENGTH, 'the delay of the effort lies at 0.1000 s'),
        ('zero', replace(GOOD, zeros=OFF), LENGTH, "swing: q1's zero is off by 8.0"),
        ('length', GOOD, (2 * LENGTH[0], 1e-4), 'P3 / P5, the length of link 1, is'),
    ],
)
def test_what_a_named_fault_explains_is_not_said_again(name, estimate, length, doubt):
    (alone,) = assess(estimate, SETTINGS, length).warnings
    assert alone.startswith(doubt)
    fault = Fault(name, 'found', 'remedy')
    assert assess(estimate, SETTINGS, length, [fault]).warnings == (fault.sentence,)


def test_an_inertia_of_nothing_is_one_failure():
    theta = PAPER.vector() * [1, 0, 0, 1, 1, 1, 1]
    free = np.array([True, False, True, True, True, True, True])
    said = assess(replace(GOOD, theta=theta, free=free), SETTINGS, (np.nan, np.nan)).warnings
    assert [text for text in said if 'P2' in text or 'M(q)' in text] == ['not physical: P2 = 0 is not positive']


def test_of_a_motion_that_tells_little_the_parameters_are_named_once():
    vague = replace(GOOD, condition_number=1e6)
    (text,) = assess(vague, SETTINGS, LENGTH).warnings
    assert text.startswith('ill-conditioned')
    (text,) = assess(replace(vague, std_error=PAPER.vector()), SETTINGS, LENGTH).warnings
    assert text.startswith('poorly determined')


def test_a_delay_at_the_end_of_its_search_is_an_error_unless_the_search_was_narrowed():
    at_end, inside, fixed = (replace(GOOD, effort=Effort('zero', delay)) for delay in (-0.1, 0.0, 0.1))
    assert assess(at_end, SETTINGS, LENGTH).level is Level.ERROR
    assert assess(inside, SETTINGS, LENGTH).level is Level.OK
    assert assess(at_end, replace(SETTINGS, delays=(-0.1, 0.01)), LENGTH).level is Level.WARN
    assert assess(fixed, replace(SETTINGS, delays=(0.1, 0.1)), LENGTH).level is Level.OK
