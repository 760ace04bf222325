# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""How a recording is read: its columns or topics, what they are taken for, and why it cannot be read yet."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from pendubot_identification.errors import PendubotError
from pendubot_identification.trajectories.conversion import Conversion
from pendubot_identification.trajectories.trajectory import Trajectory

from .bag_reader import BagReader, BagWindow, Reader, open_recording, read_trajectory
from .joint_states import JOINT_NAMES, JOINT_STATE, JOINT_STATES_TOPIC, decode_joint_state
from .survey import survey_table


@dataclass
class Inspection:
    """How a recording is read."""

    columns: list[str] = field(default_factory=list)  #: the names of a file's columns.
    units: list[str] = field(default_factory=list)  #: of these, if a header or a row gives them.
    taken: dict[str, str] = field(default_factory=dict)  #: the column of each quantity.
    topics: list[str] = field(default_factory=list)  #: of a bag, those of JointStates.
    joints: list[str] = field(default_factory=list)  #: the names of the joints on the topic.
    options: dict[str, str] = field(default_factory=dict)  #: by which it is read, as texts by name.
    taken_as: str = ''  #: the options that the file's own names and units stand for, as on the command line.
    survey: dict[str, Any] | None = None  #: of a file, as ``pendubot info --json`` prints it.
    motion: Trajectory | None = None  #: the samples, converted; None if they cannot be read.
    problem: PendubotError | None = None  #: why they cannot be read; its ``remedy`` has options that correct that.


def inspect_recording(
    window: BagWindow,
    conversion: Conversion,
    topic: str = JOINT_STATES_TOPIC,
    joint_names: Sequence[str] = JOINT_NAMES,
) -> Inspection:
    """Return how a window of a recording is read; a recording that cannot be read is described as far as possible."""
    found = Inspection(options=conversion.words())
    reader: Reader | None = None
    try:
        reader = open_recording(window.path, conversion)
        recorded = read_trajectory(window, topic=topic, joint_names=joint_names, conversion=conversion, reader=reader)
        found.motion = recorded.trajectory
    except PendubotError as error:
        found.problem = error
    with suppress(PendubotError):  # all that follows a problem stays unknown
        if isinstance(reader, BagReader):
            found.topics = [name for name, (kind, count) in reader.topics.items() if kind == JOINT_STATE and count]
            if topic in found.topics:
                found.joints = list(decode_joint_state(next(iter(next(reader.messages([topic])))).data).name)
        elif reader is not None and 'table' in vars(reader):  # else it would be read, and fail, again
            found.columns, found.units = list(reader.table.names), [reader.unit(name) for name in reader.table.names]
            found.taken_as, found.options = reader.taken_as, reader.conversion.words()
            found.taken = {q: column for q, column in reader.conversion.names.items() if column in found.columns}
            found.survey = survey_table(reader)
    return found
