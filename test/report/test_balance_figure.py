# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The picture of a swing-up."""

import math

import numpy as np

from pendubot_identification.report.balance_figure import draw_balance
from pendubot_identification.trajectories.trajectory import Trajectory


def test_it_shows_both_links_from_upright_the_torque_and_its_limit(tmp_path):
    t = np.arange(200) * 0.01
    q = np.column_stack([np.linspace(-math.pi / 2, math.pi / 2, 200), np.zeros(200)])
    motion = Trajectory(t, q, np.column_stack([np.sin(t), 0 * t]))
    draw_balance(tmp_path / 'a.svg', motion, 2.0)
    text = (tmp_path / 'a.svg').read_text()
    for words in ('from upright [degrees]', 'link 1', 'link 2', 'torque [N m]', 'time [s]'):
        assert f'<!-- {words} -->' in text
    draw_balance(tmp_path / 'a.png', motion, 2.0)
    assert (tmp_path / 'a.png').read_bytes().startswith(b'\x89PNG')
