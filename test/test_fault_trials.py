# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Every fault trial for seconds; ``python -m benchmarks.faults`` runs minutes and also checks times."""

import itertools

import pytest

from benchmarks.faults import bridge, ownership
from test.processes import BOARDS

pytestmark = [pytest.mark.ros, pytest.mark.faults]
#: The boards alternate: they answer with the same bytes (firmware/test_ownership.py).
TURNS = itertools.cycle(BOARDS)
#: The trial 'commands' has times alone, and 'quiet' what 'busy' has on a busy machine. The trial 'stuck' differs from
#: 'runaway' in its limit alone, which firmware/test_link.py tests.
CASES = [
    pytest.param(trial, next(TURNS) if trial.board else 'python', id=trial.name)
    for trial in (*bridge.TRIALS, *ownership.TRIALS)
    if trial.name not in ('commands', 'quiet', 'stuck')
]


@pytest.mark.parametrize(('trial', 'each_board'), CASES, indirect=['each_board'])
def test_under_a_fault_every_figure_meets_its_requirement(trial, each_board, ros, tmp_path):
    figures = trial.run(tmp_path, False)
    missed = [f'{figure.wanted}: {figure.measured}' for figure in figures if not (figure.met or figure.time)]
    assert not missed, '; '.join(missed)
