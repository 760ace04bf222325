# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Every fault of the table for seconds; ``python -m benchmarks.faults`` does it for minutes, and judges times too."""

import itertools

import pytest

from benchmarks.faults import bridge, ownership
from test.processes import BOARDS

pytestmark = [pytest.mark.ros, pytest.mark.faults]
#: Of the boards, which answer with the same bytes (firmware/test_ownership.py), each has every second trial.
TURNS = itertools.cycle(BOARDS)
CASES = [
    pytest.param(trial, next(TURNS) if trial.board else 'python', id=trial.name)
    for trial in (*bridge.TRIALS, *ownership.TRIALS)
]


@pytest.mark.parametrize(('trial', 'each_board'), CASES, indirect=['each_board'])
def test_it_neither_lies_nor_loses(trial, each_board, ros, tmp_path):
    figures = trial.run(tmp_path, False)
    missed = [f'{figure.wanted}: {figure.measured}' for figure in figures if not (figure.met or figure.time)]
    assert not missed, '; '.join(missed)
