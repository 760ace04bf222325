# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.identify.advice import HELP, advise
from pendubot_identification.model.parameters import NAMES
from test.identified import identified


@pytest.fixture
def estimate():
    return identified(('weak',)).best


def with_errors(estimate, **errors):
    """The estimate with other relative standard errors."""
    std_error = estimate.std_error.copy()
    for name, relative in errors.items():
        std_error[NAMES.index(name)] = relative * estimate.theta[NAMES.index(name)]
    return replace(estimate, std_error=std_error)


IDENTIFIABLE = dict.fromkeys(NAMES[:7], 0.01)


@pytest.mark.parametrize(
    ('errors', 'expected'),
    [
        ({}, []),
        ({'b2': 0.8, 'P3': 0.3}, ['b2 (its standard error is 80 % of it)', 'P3 (its standard error is 30 % of it)']),
        ({'b2': np.inf}, ['b2 (not at all)']),
        ({'b1': 3.0}, []),
        (
            {'P2': 0.5},
            ['P2 (its standard error is 50 % of it, hardly apart from P5 (correlation 0.99))'],
        ),
    ],
)
def test_names_the_worst_first_and_what_helps(estimate, errors, expected):
    """P2 goes with P5, and b1 lies on its bound."""
    correlation, free = np.eye(7), np.array(NAMES[:7]) != 'b1'
    correlation[1, 4] = correlation[4, 1] = 0.99
    poor = with_errors(replace(estimate, correlation=correlation, free=free), **IDENTIFIABLE | errors)
    assert list(advise(poor)) == [
        f'this motion tells little of {said}; what helps: {HELP[said[:2]]}' for said in expected
    ]
