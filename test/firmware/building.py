# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Compiles the firmware for tests; skips a test with the reason if a compiler or QEMU is missing."""

import fcntl
import shutil
import subprocess

import pytest

from test.conftest import ROOT

FIRMWARE = ROOT / 'firmware'
WARNINGS = ('-Wall', '-Wextra', '-Werror', '-Wconversion')
COMPILERS = {'c': ('gcc', '-std=c11'), 'c++': ('g++', '-std=c++17')}
SANITIZERS = ('-g', '-O1', '-fsanitize=address,undefined', '-fno-sanitize-recover=all')


def need(program, package):
    """Skip the test if a program is missing."""
    if shutil.which(program) is None:
        pytest.skip(f'{program} is not installed (Debian: {package})')


def compiled(target, *sources, options=(), language='c'):
    """Compile sources for this computer with sanitizers; return the program's path."""
    compiler, standard = COMPILERS[language]
    need(compiler, compiler)
    words = [compiler, standard, *WARNINGS, *SANITIZERS, *options, '-I', FIRMWARE, *sources, '-o', target, '-lm']
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return target


def made(*targets):
    """Run make in firmware/ with these targets; return the build folder."""
    need('make', 'make')
    with open(FIRMWARE / 'Makefile') as makefile:
        # Test processes may run in parallel.
        fcntl.flock(makefile, fcntl.LOCK_EX)
        done = subprocess.run(['make', '-C', FIRMWARE, *targets], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return FIRMWARE / 'build'
