# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What became of a rig's parameters: each with its band over time, changes marked, unexplained torque below."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from pendubot_identification.model.parameters import NAMES, UNITS
from pendubot_identification.tracking.tracker import NORMAL_95, Burst, Change, Event, State

from .style import GREY, rendered, style


def draw_track(states: Sequence[State], events: Sequence[Event]) -> dict[str, bytes]:
    """Return the figure of two states or more as PNG and SVG, by the ending of the file's name."""
    t = np.array([s.t for s in states])
    theta, error = (np.array([getattr(s, what) for s in states]) for what in ('theta', 'std_error'))
    with style():
        figure = Figure(figsize=(9, 1.1 * (theta.shape[1] + 1) + 0.5), layout='constrained')
        axes = figure.subplots(theta.shape[1] + 1, 1, sharex=True)
        for k, axis in enumerate(axes[:-1]):
            low, high = theta[:, k] - NORMAL_95 * error[:, k], theta[:, k] + NORMAL_95 * error[:, k]
            (line,) = axis.plot(t, theta[:, k])
            axis.fill_between(t, low, high, alpha=0.3, linewidth=0, color=line.get_color())
            # The first bands are wide: what is worth seeing are the others.
            usual = slice(len(t) // 20, None)
            ends = np.nanmin(low[usual]), np.nanmax(high[usual])
            if np.isfinite(ends).all() and ends[1] > ends[0]:
                margin = 0.1 * (ends[1] - ends[0])
                axis.set_ylim(ends[0] - margin, ends[1] + margin)
            axis.set_ylabel(f'{NAMES[k]}\n[{UNITS[k]}]')
        axes[-1].semilogy(t, [s.unexplained for s in states], color=GREY)
        axes[-1].set_ylabel('unexplained\n[N m]')
        axes[-1].set_xlabel('time [s]')
        for event in events:
            for axis in axes if isinstance(event, Change) else axes[-1:]:
                begin = max(event.begin, t[0])
                colour = 'tab:red' if isinstance(event, Change) else 'tab:orange' if isinstance(event, Burst) else 'k'
                axis.axvspan(begin, max(event.end, begin), color=colour, alpha=0.5)
        changes = [event for event in events if isinstance(event, Change)]
        axes[0].set_title('; '.join(f'{c.kind} at {c.end:.0f} s' for c in changes[:4]) or 'no change was found')
        figure.align_ylabels(axes)
        return rendered(figure)
