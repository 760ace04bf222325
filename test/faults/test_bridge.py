# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Every fault of the table for seconds; ``python -m test.faults`` does it for minutes, and judges times too."""

import pytest

from .bridge import TRIALS

pytestmark = [pytest.mark.ros, pytest.mark.faults]


@pytest.mark.parametrize('trial', TRIALS, ids=lambda trial: trial.name)
def test_it_neither_lies_nor_loses(trial, ros, tmp_path):
    figures = trial.run(tmp_path, False)
    missed = [f'{figure.wanted}: {figure.measured}' for figure in figures if not (figure.met or figure.time)]
    assert not missed, '; '.join(missed)
