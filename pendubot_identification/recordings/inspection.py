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

from .bag_reader import BagReader, BagWindow, open_recording, read_trajectory
from .joint_states import JOINT_NAMES, JOINT_STATE, JOINT_STATES_TOPIC, decode_joint_state
from .survey import survey_table
from .table_reader import TableReader


@dataclass
class Inspection:
    """How a recording is read.

    Attributes:
        columns: the names of a file's columns.
        units: of these, where a header or a row gives them.
        taken: the column of each quantity.
        topics: of a bag, those of JointStates.
        joints: the names of the joints on the topic.
        options: by which it is read, as texts by name.
        taken_as: the options that the file's own names and units stand for, as on the command line.
        survey: of a file, as ``pendubot info --json`` prints it.
        motion: the samples, converted; None if they cannot be read.
        problem: why they cannot be read; ``problem.remedy`` has the options that correct that, where they are known.
    """

    columns: list[str] = field(default_factory=list)
    units: list[str] = field(default_factory=list)
    taken: dict[str, str] = field(default_factory=dict)
    topics: list[str] = field(default_factory=list)
    joints: list[str] = field(default_factory=list)
    options: dict[str, str] = field(default_factory=dict)
    taken_as: str = ''
    survey: dict[str, Any] | None = None
    motion: Trajectory | None = None
    problem: PendubotError | None = None


def inspect_recording(
    window: BagWindow,
    conversion: Conversion,
    topic: str = JOINT_STATES_TOPIC,
    joint_names: Sequence[str] = JOINT_NAMES,
) -> Inspection:
    """Return how a window of a recording is read; a recording that cannot be read is described as far as possible."""
    found = Inspection(options=conversion.words())
    reader: BagReader | TableReader | None = None
    try:
        reader = open_recording(window.path, conversion)
        recorded = read_trajectory(window, topic=topic, joint_names=joint_names, conversion=conversion, reader=reader)
        found.motion = recorded.trajectory
    except PendubotError as error:
        found.problem = error
    with suppress(PendubotError):
        if isinstance(reader, BagReader):
            _describe_bag(reader, topic, found)
        elif reader is not None and 'table' in vars(reader):  # else it would be read, and fail, again
            _describe_table(reader, found)
    return found


def _describe_bag(reader: BagReader, topic: str, found: Inspection) -> None:
    found.topics = [name for name, (kind, count) in reader.topics.items() if kind == JOINT_STATE and count]
    if topic in found.topics:
        found.joints = list(decode_joint_state(next(iter(next(reader.messages([topic])))).data).name)


def _describe_table(reader: TableReader, found: Inspection) -> None:
    """Describe a file; what follows a problem stays unknown."""
    found.columns, found.units = list(reader.table.names), [reader.unit(name) for name in reader.table.names]
    conversion = reader.conversion
    found.taken_as, found.options = reader.taken_as, conversion.words()
    found.taken = {name: column for name, column in conversion.names.items() if column in found.columns}
    found.survey = survey_table(reader)
