# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""An effect is chosen where it is seen again and again, not where a few rows are odd."""

import numpy as np
import pytest

from pendubot_identification.identify.effects import Effect
from pendubot_identification.identify.hypotheses import select

ROWS, READINGS = 150, 32


def chosen(size, seed):
    """Return the share of what is chosen, of one effect that has another size in each row."""
    rng = np.random.default_rng(seed)
    base, effect = rng.standard_normal((ROWS, READINGS, 6)), rng.standard_normal((ROWS, READINGS, 1))
    y = rng.standard_normal((ROWS, READINGS)) + effect[..., 0] * size[:, None]
    effects = [Effect('drag', 'elbow', ((1, lambda seen: seen),), ())]
    found = select(
        effects, base, y, [effect], np.arange(ROWS) % 3, independent=y.size, pays=0.005, physical=np.full(5, 100.0)
    )
    return [choice.share for choice in found]


@pytest.mark.parametrize('seed', range(5))
def test_a_small_effect_must_show_in_many_rows(seed):
    rows = np.arange(ROWS)
    (share,) = chosen(np.full(ROWS, 0.17), seed)
    assert 0.01 < share < 0.06
    assert chosen(np.where(np.isin(rows, (3, 22, 107)), 8.5, 0.0), seed) == [], 'the same mean size, in three rows'
