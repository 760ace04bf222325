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
    scale = std_error / estimate.std_error
    return replace(estimate, std_error=std_error, covariance=estimate.covariance * np.outer(scale, scale))


def test_says_nothing_where_everything_is_told(estimate):
    assert advise(with_errors(estimate, **dict.fromkeys(NAMES[:7], 0.01))) == ()


def test_names_the_worst_first_and_what_helps(estimate):
    told = with_errors(estimate, **dict.fromkeys(NAMES[:7], 0.01))
    first, second = advise(with_errors(told, b2=0.8, P3=0.3))
    assert 'b2 (its standard error is 80 % of it' in first
    assert HELP['b2'] in first
    assert 'P3 (its standard error is 30 % of it' in second


def test_names_what_can_hardly_be_told_apart(estimate):
    correlation = np.eye(7)
    correlation[1, 4] = correlation[4, 1] = 0.99
    poor = with_errors(estimate, **dict.fromkeys(NAMES[:7], 0.01) | {'P2': 0.5, 'P5': 0.5})
    sentences = advise(replace(poor, correlation=correlation))
    assert len(sentences) == 2
    assert 'P2' in sentences[0]
    assert 'hardly apart from P5 (correlation 0.99)' in sentences[0]


def test_of_a_parameter_on_its_bound_or_not_told_at_all(estimate):
    errors = with_errors(estimate, **dict.fromkeys(NAMES[:7], 0.01))
    held = errors.free.copy()
    held[6] = False
    assert advise(replace(with_errors(errors, b2=3.0), free=held)) == ()
    (sentence,) = advise(with_errors(errors, b2=np.inf))
    assert 'b2 (not at all' in sentence


def test_there_is_help_for_every_parameter():
    assert set(HELP) == set(NAMES)
