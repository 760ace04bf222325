# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The simulated rig without imperfections is the package's model; each imperfection changes the motion."""

from dataclasses import replace

import numpy as np
import pytest

from pendubot_identification.model.dynamics import accelerations as of_package
from test.simulated_rig import CATALOGUE, GRAVITY, SIZES, UNKNOWN, Rig, accelerations, bodies, record, true

STATES = np.random.default_rng(1).normal(size=(5, 100)) * [[2.0], [2.0], [5.0], [5.0], [0.3]]


@pytest.mark.parametrize('size', SIZES)
def test_the_rig_without_imperfections_is_the_model(size):
    rig = SIZES[size]
    theta = [*list(true(rig).values())[:5], 0.0, 0.0]
    found = accelerations(*STATES, 0.0, bodies(rig.length, rig.mass))
    np.testing.assert_allclose(found, of_package(theta, *STATES, 0.0), rtol=1e-10)


def test_a_base_that_leans_turns_gravity_and_a_heavy_one_stands_still():
    q1, *rest = STATES
    leaning = accelerations(q1, *rest, 0.0, gravity=(GRAVITY * np.sin(0.1), GRAVITY * np.cos(0.1)))
    np.testing.assert_allclose(leaning, accelerations(q1 + 0.1, *rest, 0.0), rtol=1e-10)
    *heavy, a0 = accelerations(*STATES, 0.0, base=(1e12, 0.0))
    np.testing.assert_allclose(heavy, accelerations(*STATES, 0.0), rtol=1e-8)
    assert abs(a0).max() < 1e-8


def test_every_imperfection_changes_the_recording():
    rigs = {name: strengths[2] for name, strengths in (CATALOGUE | UNKNOWN).items()}
    made = record([3] * (len(rigs) + 1), [Rig(), *rigs.values()], seconds=3.0, step=0.002)
    perfect = np.column_stack([made[0].t, made[0].q])
    for name, recording in zip(rigs, made[1:], strict=True):
        assert np.isfinite(recording.q).all(), name
        same = np.column_stack([recording.t, recording.q])
        assert same.shape != perfect.shape or abs(same - perfect).max() > 1e-3, name


def test_a_rig_moves_alike_in_every_batch():
    rig = replace(CATALOGUE['lag'][0], pushes=1)
    alone = record([5], [rig], seconds=2.0, step=0.002)[0]
    among = record([4, 5, 6], [UNKNOWN['sway'][2], rig, UNKNOWN['shaft'][2]], seconds=2.0, step=0.002)[1]
    np.testing.assert_array_equal(alone.q, among.q)
