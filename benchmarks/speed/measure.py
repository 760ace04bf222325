# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Measures times side by side: only their ratios are valid on other machines."""

import os
import platform
import resource
import statistics
import subprocess
import time

import numpy as np
import scipy

from pendubot_identification import kernel

REPETITIONS = 5


def wall():
    """Return the time [s]."""
    return time.perf_counter()


def cpu():
    """Return the processor time [s] of this process and its children, for measurements on a loaded machine."""
    uses = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(use.ru_utime + use.ru_stime for use in uses)


#: The clock of all measurements.
clock = wall


def interleaved(works):
    """Return, by name, the median seconds of each of the works, a dict of callables that are run in turn."""
    spent = {name: [] for name in works}
    for _ in range(REPETITIONS):
        for name, work in works.items():
            begin = clock()
            work()
            spent[name].append(clock() - begin)
    return {name: statistics.median(seconds) for name, seconds in spent.items()}


def on(compiled, work):
    """Return the work with the compiled kernel, or with numpy."""

    def run():
        before, kernel.wanted = kernel.wanted, compiled
        try:
            return work()
        finally:
            kernel.wanted = before

    return run


def machine():
    """Return the processor, the number of cores and the versions."""
    lines = subprocess.run(['lscpu'], capture_output=True, text=True).stdout.splitlines()
    name = next((line.split(':')[1].strip() for line in lines if line.startswith('Model name')), platform.machine())
    versions = f'Python {platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}'
    return f'{name}, {os.cpu_count()} cores, {versions}'


def seconds(value):
    """Return a time with a suitable unit."""
    for unit, factor in (('s', 1), ('ms', 1e3)):
        if value * factor >= 1:
            return f'{value * factor:.3g} {unit}'
    return f'{value * 1e6:.3g} µs'
