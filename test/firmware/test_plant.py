# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The simulated pendubot in C, compared with the package's."""

import ctypes

import numpy as np
import pytest

from pendubot_identification.model.parameters import BALANCE, PAPER
from pendubot_identification.model.simulation import Plant

from .building import FIRMWARE, compiled


class PlantInC(ctypes.Structure):
    _fields_ = [
        *((name, ctypes.c_double) for name in ('P1', 'P2', 'P3', 'P4', 'P5', 'b1', 'b2')),
        ('q', ctypes.c_double * 2),
        ('v', ctypes.c_double * 2),
    ]


@pytest.fixture(scope='module')
def library(tmp_path_factory):
    path = tmp_path_factory.mktemp('plant') / 'plant.so'
    compiled(path, FIRMWARE / 'simulation/plant.c', options=('-shared', '-fPIC', '-fno-sanitize=all'))
    library = ctypes.CDLL(str(path))
    library.plant_advance.argtypes = [ctypes.POINTER(PlantInC), ctypes.c_double, ctypes.c_double]
    library.plant_counts.argtypes = [ctypes.POINTER(PlantInC), ctypes.c_int, ctypes.c_double]
    return library


@pytest.mark.parametrize(('name', 'rig'), [('plant_of_the_paper', PAPER), ('plant_to_balance', BALANCE)])
@pytest.mark.parametrize('period', [0.001, 0.01])
def test_the_plant_in_c_moves_like_the_packages_simulation(library, name, rig, period):
    c = PlantInC.from_buffer_copy(PlantInC.in_dll(library, name))
    plant = Plant(rig)
    rng = np.random.default_rng(1)
    error = 0.0
    for _ in range(round(3 / period)):
        torque = rng.uniform(-0.5, 0.5)
        plant.advance((torque, 0.0), period)
        library.plant_advance(ctypes.byref(c), torque, period)
        error = max(error, *np.abs(np.subtract(plant.q, c.q)))
    turned = [q * 4000 / (2 * np.pi) for q in (plant.q[0] + np.pi / 2, plant.q[1])]
    assert [library.plant_counts(ctypes.byref(c), joint, 4000.0) for joint in (0, 1)] == [round(t) for t in turned]
    assert error < 1e-6
