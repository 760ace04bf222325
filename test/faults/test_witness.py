# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A failure counts where the machine ran; where it stood still, the measured pause is said."""

import multiprocessing
import os
import signal
import time

import pytest

from .witness import steady_machine


def fails_after_a_pause():
    (witness,) = multiprocessing.active_children()
    os.kill(witness.pid, signal.SIGSTOP)
    time.sleep(0.1)
    os.kill(witness.pid, signal.SIGCONT)
    time.sleep(0.1)
    raise AssertionError('too late')


def test_a_failure_on_a_machine_that_stood_still_is_skipped_and_says_for_how_long():
    with pytest.raises(pytest.skip.Exception, match=r'stood still for \d{3} ms .* at most 50 ms may be: too late'):
        steady_machine(50)(fails_after_a_pause)()


def test_a_failure_is_one_where_the_machine_stood_still_for_less():
    with pytest.raises(AssertionError, match='too late'):
        steady_machine(60_000)(fails_after_a_pause)()
