# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Encodes and decodes ``sensor_msgs/msg/JointState``, and writes a motion as a bag of such messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rosbags.serde import SerdeError

from pendubot_identification.arrays import Array, Flags, Indices
from pendubot_identification.errors import BagError
from pendubot_identification.trajectories.conventions import JOINT_NAMES, TOPIC
from pendubot_identification.trajectories.trajectory import Trajectory

from .mcap_file import FIELDS, Messages
from .message_types import typestore

JOINT_STATE = 'sensor_msgs/msg/JointState'
#: Start of a motion without a clock [ns since the epoch]: fixed, so that the same motion gives the same bytes.
EPOCH_NS = 1_500_000_000_000_000_000
#: The start of a message: CDR encapsulation and stamp.
STAMP = np.dtype([('encapsulation', 'V4'), ('sec', '<i4'), ('nanosec', '<u4')])


def encode_joint_state(
    stamp_ns: int, names: Sequence[str], position: ArrayLike, velocity: ArrayLike, effort: ArrayLike, frame: str = ''
) -> bytes:
    """Return a JointState as CDR, with its encapsulation header: stamp [ns], names of the joints, and their values.

    Position [rad], velocity [rad/s] and effort [N m] have shape (number of joints,), or (0,) if unknown.
    """
    types = typestore().types
    stamp = types['builtin_interfaces/msg/Time'](*divmod(int(stamp_ns), 1_000_000_000))
    header = types['std_msgs/msg/Header'](stamp, frame)
    numbers = (np.asarray(values, dtype=np.float64) for values in (position, velocity, effort))
    message = types[JOINT_STATE](header, list(names), *numbers)
    return bytes(typestore().serialize_cdr(message, JOINT_STATE, little_endian=True))


def decode_joint_state(data: bytes, where: str = 'a message') -> Any:
    """Decode a JointState from CDR by rosbags. Raises BagError: the bytes, from ``where``, are no JointState."""
    try:
        return typestore().deserialize_cdr(data, JOINT_STATE)
    except SerdeError as error:
        raise BagError(f'{where} is no {JOINT_STATE} ({error}); record it again') from error


def stamp_of(message: Any) -> int:
    """Return the stamp of a message with a header [ns]."""
    return int(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)


def stamps_ns(starts: NDArray[np.void]) -> Indices:
    """Return the stamps [ns] in the starts of little-endian messages, dtype :data:`STAMP`; both have shape (N,)."""
    return starts['sec'].astype(np.int64) * 1_000_000_000 + starts['nanosec']


class JointDecoder:
    """Decodes two joints from blocks of JointStates; errors name ``source``.

    Efforts are read from the entries ``effort_names``, by default from the joints. rosbags decodes the first
    JointState of a layout in a block; numpy decodes all others.
    """

    def __init__(self, joint_names: Sequence[str], source: str, effort_names: Sequence[str] | None = None) -> None:
        self._joint_names, self._source = joint_names, source
        self._effort_names = effort_names or joint_names
        self._count = 0

    def __call__(self, messages: Messages) -> tuple[Indices, Array]:
        """Return stamps [ns], shape (N,), and position, effort and velocity, NaN if absent, shape (N, 3, 2).

        Raises:
            BagError: a message is no JointState, or lacks a joint, its position or its effort.
        """
        stamps, values = np.empty(len(messages), np.int64), np.full((len(messages), 3, 2), np.nan)
        remaining = np.arange(len(messages))
        while remaining.size:
            k, remaining = remaining[0], remaining[1:]
            (message,) = messages.part(slice(k, k + 1))
            where = f'{self._source}, sample {self._count + k}'
            state = decode_joint_state(message.data, where)
            joints, efforts = self._indices(state, where)
            stamps[k], values[k, :2] = stamp_of(state), (state.position[joints], state.effort[efforts])
            if len(state.velocity) == len(state.name):
                values[k, 2] = state.velocity[joints]
            if layout := _Layout.of(message.data, state, joints, efforts):
                remaining = remaining[~layout.read(messages, remaining, stamps, values)]
        self._count += len(messages)
        return stamps, values

    def _indices(self, state: Any, where: str) -> tuple[list[int], list[int]]:
        """Return the indices of both joints and of their efforts, which may be separate entries."""
        n, listed = len(state.name), ', '.join(state.name) or 'none'
        if missing := [name for name in self._joint_names if name not in state.name]:
            raise BagError(
                f'{where} has no joint {missing[0]!r}; its joints are {listed}: name two of these with --joints '
                'SHOULDER,ELBOW (in ROS and Python joint_names)'
            )
        if missing := [name for name in self._effort_names if name not in state.name]:
            raise BagError(
                f'{where} has no measured current: its joints are {listed}, and {missing[0]} is expected beside them; '
                'record with a bridge of this version, or leave out --torque-constant'
            )
        if len(state.position) != n:
            raise BagError(f'{where} has {len(state.position)} positions for {n} joints; record one for each joint')
        if len(state.effort) != n:
            raise BagError(f'{where} has {len(state.effort)} efforts for {n} joints; record one for each joint')
        joints, efforts = (
            [state.name.index(name) for name in names] for names in (self._joint_names, self._effort_names)
        )
        return joints, efforts


class _Layout(NamedTuple):
    """The layout of JointStates with the same frame and names."""

    example: NDArray[np.uint8]  #: bytes of one message, shape (size,).
    same: NDArray[np.uint8]  #: 255 for a byte that all messages share, else 0, shape (size,).
    offsets: list[int]  #: offsets [bytes] of both positions, both efforts and, if present, both velocities.

    @classmethod
    def of(cls, data: bytes, state: Any, joints: list[int], efforts: list[int]) -> _Layout | None:
        """Return the layout of a message; None for another byte order or a message with further bytes."""
        again = encode_joint_state(0, state.name, state.position, state.velocity, state.effort, state.header.frame_id)
        if len(again) != len(data) or again[:2] != data[:2]:
            return None
        # The arrays are last in the message; their length and padding to 8 bytes precede each.
        n, m = len(state.name), len(state.velocity)
        effort = len(data) - 8 * n
        velocity = effort - 8 * (m + 1) if m else effort
        position = velocity - 8 * (n + 1)
        example = np.frombuffer(data, np.uint8)
        # Bytes that differ from the encoder's are padding with arbitrary content.
        same = np.where(example == np.frombuffer(again, np.uint8), 255, 0).astype(np.uint8)
        for start, size in ((4, 8), (position, 8 * n), (velocity, 8 * m), (effort, 8 * n)):
            same[start : start + size] = 0  # the stamp and the numbers
        offsets = [position + 8 * k for k in joints] + [effort + 8 * k for k in efforts]
        return cls(example, same, offsets + [velocity + 8 * k for k in joints if m == n])

    def read(self, messages: Messages, selected: NDArray[np.intp], stamps: Indices, values: Array) -> Flags:
        """Decode the selected messages that have this layout into stamps and values; return the mask of these."""
        size = len(self.example)
        matching = messages.heads['length'][selected] == FIELDS + size
        rows = messages.part(selected[matching]).contents(f'V{size}').view(np.uint8).reshape(-1, size)
        matching[matching] = same = ~((rows ^ self.example) & self.same).any(axis=1)
        rows, selected = rows[same], selected[matching]
        stamps[selected] = stamps_ns(rows[:, : STAMP.itemsize].view(STAMP)[:, 0])
        for k, offset in enumerate(self.offsets):
            values.reshape(-1, 6)[selected, k] = rows[:, offset : offset + 8].view('<f8')[:, 0]
        return matching


def write_trajectory(
    path: Path, trajectory: Trajectory, *, overwrite: bool = False, progress: Callable[[int], None] | None = None
) -> None:
    """Write a motion as a complete bag with the topic ``/joint_states``, or none.

    The messages have velocities if the motion has. ``progress`` is called with the number of samples written.

    Raises:
        BagError: the name is taken, or writing fails.
    """
    from .bag_writer import complete_bag  # readers do not need it

    if (last := EPOCH_NS / 1e9 + float(trajectory.t.max(initial=0.0))) >= 2**31:
        raise BagError(
            f'{trajectory.name}: its last stamp would be {last:.6g} s after 1970, and stamps of ROS end in 2038; '
            'correct its times'
        )
    order = np.arange(len(trajectory))
    stamps = EPOCH_NS + np.rint(trajectory.t * 1e9).astype(np.int64)
    # Stamps must increase even if times increase by less than a nanosecond.
    stamps = np.maximum.accumulate(stamps - order) + order
    with complete_bag(path, overwrite=overwrite) as bag:
        channel = bag.add_topic(TOPIC.default, JOINT_STATE)
        for k, stamp in enumerate(stamps.tolist()):
            velocity = () if trajectory.qd is None else trajectory.qd[k]
            data = encode_joint_state(stamp, JOINT_NAMES, trajectory.q[k], velocity, trajectory.tau[k])
            bag.write(channel, data, stamp, sequence=k + 1)
            if progress is not None and k % 1000 == 0:
                progress(k)
