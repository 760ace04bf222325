# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Compiles the firmware for tests; where a compiler or QEMU is missing, the test is skipped and says so."""

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
    """Skip the test where a program is missing."""
    if shutil.which(program) is None:
        pytest.skip(f'{program} is not installed (Debian: {package})')


def compiled(target, *sources, options=(), language='c'):
    """Compile sources for this computer, under sanitizers; return the program's path."""
    compiler, standard = COMPILERS[language]
    need(compiler, compiler)
    words = [compiler, standard, *WARNINGS, *SANITIZERS, *options, '-I', FIRMWARE, *sources, '-o', target, '-lm']
    done = subprocess.run(list(map(str, words)), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return target


def made(*targets):
    """Let make build something in firmware/, and return the folder with what was built."""
    need('make', 'make')
    with open(FIRMWARE / 'Makefile') as makefile:
        # One at a time, where several processes test.
        fcntl.flock(makefile, fcntl.LOCK_EX)
        done = subprocess.run(['make', '-C', FIRMWARE, *targets], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return FIRMWARE / 'build'
