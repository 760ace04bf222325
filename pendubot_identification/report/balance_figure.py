# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A figure of a swing-up."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from pendubot_identification.trajectories.trajectory import Trajectory

from .style import GREY, style
from .time_plot import Line, Panel, TimePlot


def draw_balance(path: Path, motion: Trajectory, limit: float) -> None:
    """Draw the angles of both links from upright, and the torque, into a file whose name states the format.

    Args:
        path: of the picture; its folder exists.
        motion: from the start on, in the order of time.
        limit: largest torque [N m].
    """
    t = motion.t - motion.t[0]
    angles = [
        Line(label, [(t, np.degrees(np.remainder(angle + math.pi / 2, 2 * math.pi) - math.pi))], colour, style='dots')
        for label, angle, colour in (('link 1', motion.q[:, 0], '#0072b2'), ('link 2', motion.q.sum(axis=1), '#d55e00'))
    ]
    limits = [Line('', [(t[[0, -1]], np.full(2, bound))], GREY) for bound in (-limit, limit)]
    torque = Line('', [(t, motion.tau[:, 0])], 'black', 0.7, 'steps')
    panels = [Panel('from upright', 'degrees', angles, (-185, 185)), Panel('torque', 'N m', [torque, *limits])]
    with style():
        TimePlot(panels).figure().savefig(path)
