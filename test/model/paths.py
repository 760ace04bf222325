# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Tests with both implementations of simulations: the compiled kernel and numpy."""

import contextlib

import pytest

from pendubot_identification import kernel

both_paths = pytest.mark.parametrize('compiled', [True, False], ids=['kernel', 'numpy'])


@contextlib.contextmanager
def path(compiled):
    """Simulate by the kernel or by numpy; skip the test if the kernel is missing."""
    before = kernel.wanted
    if compiled and kernel.library() is None:
        pytest.skip(kernel.description())
    kernel.wanted = compiled
    try:
        yield
    finally:
        kernel.wanted = before
