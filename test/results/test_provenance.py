# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The recordings and settings of a result are recovered from it."""

from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.identification.settings import Settings
from pendubot_identification.model.parameters import NAMES, Bounds
from pendubot_identification.recordings.datasets import load_datasets
from pendubot_identification.results.assemble import assemble_result
from pendubot_identification.results.provenance import recordings, settings
from test.conftest import ROOT
from test.identified import identified

SAMPLE = ROOT / 'bags' / 'paper_experiment'


@pytest.mark.parametrize(('bags', 'validate'), [(['{}'], []), (['{}@5:9'], []), (['{}@0:6', '{}@12:'], ['{}'])])
def test_recordings_of_a_result_are_divided_as_in_the_identification(bags, validate):
    data = load_datasets([b.format(SAMPLE) for b in bags], [v.format(SAMPLE) for v in validate])
    again = recordings(assemble_result(identified(('weak',)), data.sources))
    for motions, before in zip(again, (data.training, data.validation), strict=True):
        assert [m.name for m in motions] == [m.name for m in before]
        for motion, other in zip(motions, before, strict=True):
            np.testing.assert_array_equal(np.column_stack([motion.t, motion.q]), np.column_stack([other.t, other.q]))


def test_settings_of_a_result_are_read_back():
    options = {'sliding': 0.4, 'smoothing': 0.03, 'hold': 'linear', 'delays': (-0.02, 0.01)}
    options |= {'link_length': 0.2, 'link_mass': 0.3}
    bounds = Bounds(np.zeros(9), np.arange(1.0, 10.0), NAMES[:9])
    original = Settings(('weak', 'energy'), 'coulomb', 'lsq', seed=7, bounds=bounds, **options)
    again = settings(assemble_result(replace(identified(('weak',)), settings=original), []))
    assert repr(again) == repr(original)
