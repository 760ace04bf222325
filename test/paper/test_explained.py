# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""With the true parameters of a finely sampled motion both sides of the balance agree, and simulation repeats it."""

import numpy as np

from pendubot_identification.model.parameters import PAPER
from pendubot_identification.model.simulation import simulate
from pendubot_identification.paper.explained import energy_balance, predicted


def motion(rate, seconds=2.0):
    t = np.arange(round(seconds * rate)) / rate
    return simulate(PAPER, t, np.column_stack([0.15 * np.sin(4 * t), np.zeros_like(t)]))


def test_energy_received_is_energy_gained():
    recorded = motion(1000)
    balance = energy_balance(recorded, PAPER.vector())
    assert balance.t.shape == balance.gained.shape == balance.received.shape == (len(recorded) - 1,)
    assert np.abs(balance.received - balance.gained).max() < 0.01 * np.ptp(balance.gained)
    wrong = energy_balance(recorded, PAPER.vector() * [1.5, 1, 1, 1, 1, 1, 1])
    assert np.abs(wrong.received - wrong.gained).max() > 0.1 * np.ptp(balance.gained)


def test_pieces_cover_the_motion_and_repeat_it():
    recorded = motion(200)
    pieces = predicted(recorded, PAPER, 0.5)
    assert [len(piece) for piece in pieces] == [100] * 4
    np.testing.assert_allclose(np.concatenate([piece.t for piece in pieces]), recorded.t)
    assert np.abs(np.concatenate([piece.q for piece in pieces]) - recorded.q).max() < 0.01
