# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Statistics of bags and of files with columns: times, losses, ranges, and their conversion."""

import math
import re
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from pendubot_identification.arrays import Indices
from pendubot_identification.errors import PendubotError
from pendubot_identification.trajectories.conversion import Conversion
from pendubot_identification.trajectories.trajectory import Trajectory

from .bag_reader import BagReader, BagWindow, Reader, open_recording, read_trajectory
from .joint_states import JOINT_STATE, STAMP, decode_joint_state, stamps_ns
from .mcap_file import FIELDS
from .table_reader import TableReader

#: A definition whose first field is a header; comments and constants hold no bytes.
HEADER = re.compile(rb'(?:[^\S\n]*(?:#.*|[^#\n]*=.*)?\n)*[^\S\n]*(?:std_msgs/(?:msg/)?)?Header\s')
UNITS = {'q1': 'rad', 'q2': 'rad', 'dq1': 'rad/s', 'dq2': 'rad/s', 'tau1': 'N m', 'tau2': 'N m'}


@dataclass(frozen=True, slots=True)
class SurveySettings:
    """Thresholds for gaps and clocks."""

    gap: float = 1.5  #: A gap is longer than this many median intervals.
    minimum_intervals: int = 10  #: Fewest intervals for a median.
    same_clock: float = 86400.0  #: Largest difference of stamps and log times of the same clock [s].


SETTINGS = SurveySettings()


def survey_bag(bag: BagReader) -> list[dict[str, Any]]:
    """Scan all files of a bag; return statistics of the messages of each topic, for JSON: times in s, rates in Hz.

    Raises:
        OSError: a file cannot be read.
    """
    nothing = np.empty(0, np.int64)
    columns = {name: ([nothing], [nothing], [nothing]) for name in bag.topics}
    for file in bag.files:
        schemas = [schema for schema in file.schemas.values() if schema.encoding == 'ros2msg']
        with_header = {schema.id for schema in schemas if HEADER.match(schema.data)}
        for messages in file.scan():
            channels = messages.heads['channel']
            for number in file.channels.keys() & set(channels.tolist()):
                part, channel = messages.part(channels == number), file.channels[number]
                logged, stamps, numbers = columns[channel.topic]
                logged.append(part.heads['logged'])
                numbers.append(part.heads['sequence'])
                if channel.schema_id in with_header and part.heads['length'].min() >= FIELDS + STAMP.itemsize:
                    stamps.append(stamps_ns(part.contents(STAMP)))
    return [
        {'name': name, 'type': type_name} | _statistics(*map(np.concatenate, columns[name]))
        for name, (type_name, _) in bag.topics.items()
    ]


def _statistics(logged: Indices, stamps: Indices, numbers: Indices) -> dict[str, Any]:
    """Return statistics of messages from log times [ns], stamps [ns], if all have one, and sequence numbers."""
    stamped = len(stamps) == len(logged) > 0 and bool(stamps.all())
    if (logged[1:] < logged[:-1]).any():
        order = np.argsort(logged, kind='stable')
        logged, stamps = logged[order], stamps[order] if stamped else stamps
    span = float(np.ptp(logged)) / 1e9 if len(logged) else 0.0
    latency = (logged - stamps) / 1e9 if stamped else np.empty(0)
    same_clock = stamped and max(latency.max(), -latency.min()) < SETTINGS.same_clock
    return {
        'messages': len(logged),
        'lost': missing_numbers(numbers),
        'rate': (len(logged) - 1) / span if span else 0.0,
        'stamped': stamped,
        **regularity(stamps if stamped else logged),
        'latency': float(np.median(latency)) if same_clock else None,
        'latency_max': float(latency.max()) if same_clock else None,
    }


def regularity(times_ns: Indices) -> dict[str, Any]:
    """Return the regularity of times in the order of arrival [ns], shape (N,), for JSON; None if unknown.

    ``period`` is the median interval, ``jitter`` the 99 % quantile of the deviations from it, ``longest`` the longest
    interval, ``first_gap`` the start of the first gap [s]; ``gaps``, the samples ``missing`` in them, times that are
    ``repeated`` and times that run ``backwards`` are counted.
    """
    steps = np.diff(times_ns)
    # A decreasing time does not shorten the next gap.
    intervals = np.diff(np.maximum.accumulate(times_ns))
    intervals = intervals[intervals > 0]
    known = len(intervals) >= SETTINGS.minimum_intervals
    period = float(np.median(intervals)) if known else math.nan
    late = np.flatnonzero(intervals > SETTINGS.gap * period)
    return {
        'period': period / 1e9 if known else None,
        'jitter': float(np.quantile(np.abs(intervals - period), 0.99)) / 1e9 if known else None,
        'longest': float(intervals.max(initial=0)) / 1e9,
        'gaps': len(late),
        'missing': int(np.rint(intervals[late] / period - 1).sum()),
        'first_gap': float(intervals[: late[0]].sum()) / 1e9 if len(late) else None,
        'repeated': int((steps == 0).sum()),
        'backwards': int((steps < 0).sum()),
    }


def missing_numbers(numbers: Indices) -> int:
    """Return the number of missing sequence numbers of a recorder; recorders without them write zeros."""
    steps = np.diff(np.sort(numbers[numbers > 0]))
    return int((steps[steps > 1] - 1).sum())


def survey_table(reader: TableReader) -> dict[str, Any]:
    """Return statistics of the motion of a file: times in s, rates in Hz, quantities in rad and N m.

    Raises:
        TableError: it cannot be read.
    """
    motion, names, rows = reader.motion, reader.table.names, len(reader.table.cells[0])
    del reader.table  # as large as the motion
    columns = {'q1': motion.q[:, 0], 'q2': motion.q[:, 1], 'tau1': motion.tau[:, 0], 'tau2': motion.tau[:, 1]}
    if motion.qd is not None:
        columns |= {'dq1': motion.qd[:, 0], 'dq2': motion.qd[:, 1]}
    return {
        'file': str(reader.path),
        'columns': reader.taken,
        'not_taken': [name for name in names if name not in reader.taken.values()],
        'read_with': reader.conversion.options(),
        'samples': len(motion),
        'left_out': rows - len(motion),
        'duration': motion.duration,
        'rate': (len(motion) - 1) / motion.duration if motion.duration else 0.0,
        **regularity(np.rint(motion.t * 1e9).astype(np.int64)),
        'quantities': {
            name: {'least': float(x.min()), 'greatest': float(x.max()), 'first': float(x[0]), 'last': float(x[-1])}
            for name, x in columns.items()
            if name in reader.taken
        },
    }


def as_text(found: dict[str, Any]) -> str:
    """Return a survey as text."""
    left_out = f', {found["left_out"]} left out' if found['left_out'] else ''
    lines = [f'{found["samples"]} samples{left_out}, {found["duration"]:.3f} s, {found["rate"]:.1f} Hz']
    taken = ', '.join(name if name == column else f'{name} = {column}' for name, column in found['columns'].items())
    lines.append(f'taken     {taken}' + (f'; not {", ".join(found["not_taken"])}' if found['not_taken'] else ''))
    if found['read_with']:
        lines.append(f'read      {" ".join(found["read_with"])}')
    if found['period'] is not None:
        gaps = f'{found["gaps"]} gaps, the first after {found["first_gap"]:.3f} s' if found['gaps'] else 'no gaps'
        lines.append(
            f'jitter    {1e3 * found["jitter"]:.3f} ms; {gaps}; longest interval {1e3 * found["longest"]:.3f} ms'
        )
    lines.append(f'{"":12}{"least":>12}{"greatest":>12}{"first":>12}{"last":>12}')
    for name, values in found['quantities'].items():
        lines.append(f'{f"{name} [{UNITS[name]}]":12}' + ''.join(f'{value:12.4g}' for value in values.values()))
    return '\n'.join(lines)


@dataclass
class Inspection:
    """Columns or topics, conversion and samples of a recording, or the problem."""

    columns: list[str] = field(default_factory=list)  #: names of the columns of a file.
    taken: dict[str, str] = field(default_factory=dict)  #: column of each quantity.
    topics: list[str] = field(default_factory=list)  #: topics of a bag with JointStates.
    joints: list[str] = field(default_factory=list)  #: names of the joints on the topic.
    options: dict[str, str] = field(default_factory=dict)  #: options of the conversion, as texts by name.
    taken_as: str = ''  #: options inferred from the columns, as on the command line.
    motion: Trajectory | None = None  #: converted samples; None if unreadable.
    problem: PendubotError | None = None  #: reason; its ``remedy`` has options that correct it.


def inspect_recording(window: BagWindow, conversion: Conversion) -> Inspection:
    """Inspect a window of a recording; an unreadable recording is described as far as possible."""
    found = Inspection(options=conversion.words())
    reader: Reader | None = None
    try:
        reader = open_recording(window.path, conversion)
        found.motion = read_trajectory(window, conversion, reader).trajectory
    except PendubotError as error:
        found.problem = error
    with suppress(PendubotError):  # a second problem leaves fields empty
        if isinstance(reader, BagReader):
            found.topics = [name for name, (kind, count) in reader.topics.items() if kind == JOINT_STATE and count]
            if conversion.topic in found.topics:
                first = next(iter(next(reader.messages([conversion.topic]))))
                found.joints = list(decode_joint_state(first.data).name)
        elif reader is not None and 'table' in vars(reader):  # else a failed reading would be repeated
            found.columns = list(reader.table.names)
            found.taken_as, found.options = reader.taken_as, reader.conversion.words()
            found.taken = {q: column for q, column in reader.conversion.names.items() if column in found.columns}
    return found
