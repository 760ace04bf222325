# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A swing-up as a picture."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pendubot_identification.trajectories.trajectory import Trajectory


def draw_balance(path: Path, motion: Trajectory, limit: float) -> None:
    """Draw how far both links are from upright, and the torque, into a file whose name tells the format.

    Args:
        path: of the picture; its folder exists.
        motion: from the start on, in the order of time.
        limit: largest torque [N m].
    """
    # Not by pyplot, which keeps figures and may look for a screen.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    t = motion.t - motion.t[0]
    figure = Figure(figsize=(8, 5), layout='constrained')
    FigureCanvasAgg(figure)
    angles, torque = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    for label, angle in (('link 1', motion.q[:, 0]), ('link 2', motion.q.sum(axis=1))):
        angles.plot(t, _degrees_from_upright(angle), '.', markersize=1.5, label=label)
    angles.set(ylabel='from upright [degrees]', ylim=(-185, 185), yticks=range(-180, 181, 90))
    angles.legend(loc='upper right', markerscale=6)
    torque.plot(t, motion.tau[:, 0], drawstyle='steps-post', linewidth=0.7, color='black')
    torque.set(ylabel='torque [N m]', xlabel='time [s]')
    for bound in (-limit, limit):
        torque.axhline(bound, color='grey', linestyle=':', linewidth=0.8)
    for axes in (angles, torque):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=120)


def _degrees_from_upright(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.degrees(np.remainder(angle - math.pi / 2 + math.pi, 2 * math.pi) - math.pi)
