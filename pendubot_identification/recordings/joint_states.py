# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``sensor_msgs/msg/JointState`` as bytes, one by one or many at once, and bags of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rosbags.serde import SerdeError

from pendubot_identification.arrays import Array, Flags, Indices
from pendubot_identification.errors import BagError
from pendubot_identification.trajectories.conventions import JOINT_NAMES, JOINT_STATES_TOPIC
from pendubot_identification.trajectories.trajectory import Trajectory

from .mcap_file import FIELDS, Messages
from .message_types import typestore

JOINT_STATE = 'sensor_msgs/msg/JointState'
#: Start of a motion without a clock [ns since the epoch]: fixed, so that the same motion gives the same bytes.
EPOCH_NS = 1_500_000_000_000_000_000
#: CDR's encapsulation, and the stamp with which a header begins.
STAMP = np.dtype([('encapsulation', 'V4'), ('sec', '<i4'), ('nanosec', '<u4')])


def encode_joint_state(
    stamp_ns: int, names: Sequence[str], position: ArrayLike, velocity: ArrayLike, effort: ArrayLike, frame: str = ''
) -> bytes:
    """Return a JointState as CDR, with its encapsulation header: stamp [ns], names of the joints, and their values.

    Position [rad], velocity [rad/s] and effort [N m] have shape (number of joints,), or (0,) where they are unknown.
    """
    types = typestore().types
    stamp = types['builtin_interfaces/msg/Time'](*divmod(int(stamp_ns), 1_000_000_000))
    header = types['std_msgs/msg/Header'](stamp, frame)
    numbers = (np.asarray(values, dtype=np.float64) for values in (position, velocity, effort))
    message = types[JOINT_STATE](header, list(names), *numbers)
    return bytes(typestore().serialize_cdr(message, JOINT_STATE, little_endian=True))


def decode_joint_state(data: bytes, where: str = 'a message') -> Any:
    """Return a JointState in CDR as rosbags' message. Raises BagError: the bytes, from ``where``, are no JointState."""
    try:
        return typestore().deserialize_cdr(data, JOINT_STATE)
    except SerdeError as error:
        raise BagError(f'{where} is no {JOINT_STATE} ({error}); record it again') from error


def stamp_of(message: Any) -> int:
    """Return the stamp of a message with a header [ns]."""
    return int(message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec)


def stamps_ns(found: NDArray[np.void]) -> Indices:
    """Return stamps [ns], shape (N,), of the starts of little-endian messages, each a :data:`STAMP`."""
    return found['sec'].astype(np.int64) * 1_000_000_000 + found['nanosec']


class JointDecoder:
    """Reads two joints from many JointStates at once; ``source`` is named in errors.

    Efforts are those of ``effort_names``, by default of the joints themselves. rosbags decodes one JointState; numpy
    reads all others of the same layout.
    """

    def __init__(self, joint_names: Sequence[str], source: str, effort_names: Sequence[str] | None = None) -> None:
        self._joint_names, self._source = joint_names, source
        self._effort_names = effort_names or joint_names
        self._count = 0
        self._layout: _Layout | None = None

    def __call__(self, messages: Messages) -> tuple[Indices, Array]:
        """Return stamps [ns], shape (N,), and position, effort and velocity, NaN where there is none, shape (N, 3, 2).

        Raises:
            BagError: one is no JointState, or lacks a joint, its position or its effort.
        """
        stamps, values = np.empty(len(messages), np.int64), np.full((len(messages), 3, 2), np.nan)
        remaining = np.arange(len(messages))
        while remaining.size:
            if self._layout is not None:
                remaining = remaining[~self._layout.read(messages, remaining, stamps, values)]
            if remaining.size:
                k, remaining = remaining[0], remaining[1:]
                (message,) = messages.part(slice(k, k + 1))
                where = f'{self._source}, sample {self._count + k}'
                state = decode_joint_state(message.data, where)
                joints, efforts = self._indices(state, where)
                stamps[k], values[k, :2] = stamp_of(state), (state.position[joints], state.effort[efforts])
                if len(state.velocity) == len(state.name):
                    values[k, 2] = state.velocity[joints]
                self._layout = _Layout.of(message.data, state, joints, efforts)
        self._count += len(messages)
        return stamps, values

    def _indices(self, state: Any, where: str) -> tuple[list[int], list[int]]:
        """Return the indices of both joints and of their efforts, which may be separate entries."""
        n, there = len(state.name), ', '.join(state.name) or 'none'
        if missing := [name for name in self._joint_names if name not in state.name]:
            raise BagError(
                f'{where} has no joint {missing[0]!r}; its joints are {there}: name two of these with --joints '
                'SHOULDER,ELBOW'
            )
        if missing := [name for name in self._effort_names if name not in state.name]:
            raise BagError(
                f'{where} has no measured current: its joints are {there}, and {missing[0]} is expected beside them; '
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

    example: NDArray[np.uint8]  #: the bytes of one of them.
    same: NDArray[np.uint8]  #: 255 for each byte in which all of them are the same, else 0.
    offsets: list[int]  #: of the decoder's numbers: positions, efforts and, if there are any, velocities.

    @classmethod
    def of(cls, data: bytes, state: Any, joints: list[int], efforts: list[int]) -> _Layout | None:
        """Return the layout of a message; None for another byte order or a message with further bytes."""
        again = encode_joint_state(0, state.name, state.position, state.velocity, state.effort, state.header.frame_id)
        if len(again) != len(data) or again[:2] != data[:2]:
            return None
        # The arrays end the message; before each stand its length and the padding to 8 bytes.
        n, m = len(state.name), len(state.velocity)
        effort = len(data) - 8 * n
        velocity = effort - 8 * (m + 1) if m else effort
        position = velocity - 8 * (n + 1)
        example = np.frombuffer(data, np.uint8)
        # Bytes that differ from the encoder's are padding, which has any content.
        same = np.where(example == np.frombuffer(again, np.uint8), 255, 0).astype(np.uint8)
        for start, size in ((4, 8), (position, 8 * n), (velocity, 8 * m), (effort, 8 * n)):
            same[start : start + size] = 0  # the stamp and the numbers
        offsets = [position + 8 * k for k in joints] + [effort + 8 * k for k in efforts]
        return cls(example, same, offsets + [velocity + 8 * k for k in joints if m == n])

    def read(self, messages: Messages, which: NDArray[np.intp], stamps: Indices, values: Array) -> Flags:
        """Read those of the messages ``which`` that have this layout into their places; return a mask of them."""
        size = len(self.example)
        found = messages.heads['length'][which] == FIELDS + size
        rows = messages.part(which[found]).contents(f'V{size}').view(np.uint8).reshape(-1, size)
        found[found] = same = ~((rows ^ self.example) & self.same).any(axis=1)
        rows, which = rows[same], which[found]
        stamps[which] = stamps_ns(rows[:, : STAMP.itemsize].view(STAMP)[:, 0])
        for k, at in enumerate(self.offsets):
            values.reshape(-1, 6)[which, k] = rows[:, at : at + 8].view('<f8')[:, 0]
        return found


def write_trajectory(
    path: Path, trajectory: Trajectory, *, overwrite: bool = False, progress: Callable[[int], None] | None = None
) -> None:
    """Write a motion as a complete bag with the topic ``/joint_states``, or none.

    Without velocities, the messages have none. ``progress`` is called with the number of samples written.

    Raises:
        BagError: the name is taken, or the system refuses to write.
    """
    from .bag_writer import complete_bag  # readers do not need it

    if (last := EPOCH_NS / 1e9 + float(trajectory.t.max(initial=0.0))) >= 2**31:
        raise BagError(
            f'{trajectory.name}: its last stamp would be {last:.6g} s after 1970, and a stamp of ROS ends in 2038; '
            'correct its times'
        )
    order = np.arange(len(trajectory))
    stamps = EPOCH_NS + np.rint(trajectory.t * 1e9).astype(np.int64)
    # Stamps must increase even if times increase by less than a nanosecond.
    stamps = np.maximum.accumulate(stamps - order) + order
    with complete_bag(path, overwrite=overwrite) as bag:
        channel = bag.add_topic(JOINT_STATES_TOPIC, JOINT_STATE)
        for k, stamp in enumerate(stamps.tolist()):
            velocity = () if trajectory.qd is None else trajectory.qd[k]
            data = encode_joint_state(stamp, JOINT_NAMES, trajectory.q[k], velocity, trajectory.tau[k])
            bag.write(channel, data, stamp, sequence=k + 1)
            if progress is not None and k % 1000 == 0:
                progress(k)
