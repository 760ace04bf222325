# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The types of the Python interface for its callers: ``make lint`` checks this module, and nothing runs it."""

from pathlib import Path
from typing import TYPE_CHECKING

from pendubot_identification import Identified, Level, Pendubot, Trajectory, accelerations, identify, read, simulate
from pendubot_identification.arrays import Array

if TYPE_CHECKING:
    from typing_extensions import assert_type


def types(rig: Pendubot) -> None:
    motion = assert_type(read('a.csv', negate='q1', offset={'q1': '3deg'}), Trajectory)
    found = assert_type(identify(Path('a'), motion, validate=['c'], bounds={'P1': (0, 1), 'b2': 0}), Identified)
    assert_type(identify(t=motion.t, q=motion.q, tau=[0.0, 1.0], criterion=['weak', 'energy'], delay=0.0), Identified)
    assert_type((found.pendubot, found.theta, found.intervals), tuple[Pendubot, Array, Array])
    assert_type((found.level, found.warnings, found.command), tuple[Level, list[str], str])
    assert_type((found.report('look'), rig.export('a.urdf'), Pendubot.load('a.yaml')), tuple[Path, Path, Pendubot])
    assert_type(simulate(rig, motion.t, 0.3), Trajectory)
    assert_type((rig.mass_matrix(motion.q), rig.linearised()), tuple[Array, tuple[Array, Array]])
    assert_type(accelerations(rig.theta, 0.1, 0.2, 0.3, 0.4, 0.5, 0.0), tuple[float, float])
    identify('a', criterion='weka')  # type: ignore[arg-type]
    identify('a', critrion='weak')  # type: ignore[call-arg]
    read('a', time_unit='min')  # type: ignore[arg-type]
