# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Tracks the parameters of a rig through recordings."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pendubot_identification.identify.estimate import Progress
from pendubot_identification.recordings.bag_reader import BagWindow, open_recording, stream_samples
from pendubot_identification.tracking.events import Start, State
from pendubot_identification.tracking.tracker import Tracker
from pendubot_identification.tracking.windows import InformativeWindows
from pendubot_identification.trajectories.conversion import Conversion

from .track_file import Track

#: Time between two recordings of one stream [s].
BETWEEN = 10.0


def track_recordings(
    start: Start,
    windows: Sequence[BagWindow],
    topic: str,
    joint_names: Sequence[str],
    conversion: Conversion,
    progress: Progress,
) -> tuple[Tracker, Track]:
    """Track a rig through windows of recordings, one after the other, and return the tracker and its history.

    Raises:
        PendubotError: a recording cannot be read or tracked.
    """
    tracker, track, base = Tracker(start), Track(), 0.0
    for window in windows:
        reader, until, informative = open_recording(window.path, conversion), base, InformativeWindows()
        if reader.note:
            track.notes.append(f'{window}: {reader.note}')
        for samples in stream_samples(reader, window, topic, joint_names, conversion):
            informative.add(samples)
            samples[:, 0] += base
            until = max(until, float(samples[-1, 0]))
            progress(f'following {window}', round(until - base), 0, math.nan)
            for event in tracker.feed(samples):
                track.add(event)
                if not isinstance(event, State):
                    informative.happened(event, base)
        if until > base and (cut := window.cut(until - base)):
            track.notes.append(cut)
        track.windows += [str(BagWindow(window.path, *found)) for found in informative.best()]
        base = until + BETWEEN
    return tracker, track
