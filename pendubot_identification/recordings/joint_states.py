"""``sensor_msgs/msg/JointState`` as bytes, and a motion as a bag of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rosbags.serde import SerdeError

from pendubot_identification.errors import BagError
from pendubot_identification.trajectories.trajectory import Trajectory

from .bag_writer import BagWriter
from .message_types import typestore

JOINT_STATE = 'sensor_msgs/msg/JointState'
JOINT_STATES_TOPIC = '/joint_states'
JOINT_NAMES = ('shoulder', 'elbow')

#: When a motion that no clock saw begins [ns since the epoch]: fixed, so that the same motion gives the same bytes.
EPOCH_NS = 1_500_000_000_000_000_000


class JointState(NamedTuple):
    """One message's content: stamp [ns], and per named joint position [rad], velocity [rad/s], effort [N m].

    Position, velocity and effort have shape (number of joints,), or (0,) where they are not known.
    """

    stamp_ns: int
    names: tuple[str, ...]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    effort: NDArray[np.float64]


def encode_joint_state(
    stamp_ns: int, names: Sequence[str], position: ArrayLike, velocity: ArrayLike, effort: ArrayLike
) -> bytes:
    """Return a JointState as CDR, with its encapsulation header; units and shapes as in :class:`JointState`."""
    types = typestore().types
    sec, nanosec = divmod(int(stamp_ns), 1_000_000_000)
    stamp = types['builtin_interfaces/msg/Time'](sec=sec, nanosec=nanosec)
    message = types[JOINT_STATE](
        header=types['std_msgs/msg/Header'](stamp=stamp, frame_id=''),
        name=list(names),
        position=np.asarray(position, dtype=np.float64),
        velocity=np.asarray(velocity, dtype=np.float64),
        effort=np.asarray(effort, dtype=np.float64),
    )
    return bytes(typestore().serialize_cdr(message, JOINT_STATE, little_endian=True))


def decode_joint_state(data: bytes) -> JointState:
    """Return what a JointState in CDR holds.

    Raises:
        BagError: the bytes are no JointState.
    """
    try:
        message: object = typestore().deserialize_cdr(data, JOINT_STATE)
    except SerdeError as error:
        raise BagError(f'a message is no {JOINT_STATE} ({error}); record it again') from error
    stamp = message.header.stamp  # type: ignore[attr-defined]
    return JointState(
        stamp_ns=stamp.sec * 1_000_000_000 + stamp.nanosec,
        names=tuple(message.name),  # type: ignore[attr-defined]
        position=message.position,  # type: ignore[attr-defined]
        velocity=message.velocity,  # type: ignore[attr-defined]
        effort=message.effort,  # type: ignore[attr-defined]
    )


def write_trajectory(
    path: Path,
    trajectory: Trajectory,
    *,
    joint_names: Sequence[str] = JOINT_NAMES,
    start_ns: int = EPOCH_NS,
    overwrite: bool = False,
) -> None:
    """Write a motion as a bag with the topic ``/joint_states``.

    Args:
        path: the bag's folder.
        trajectory: the motion; where it has no velocities, the messages have none.
        joint_names: of the two joints, shoulder first.
        start_ns: the stamp that stands for t = 0 [ns since the epoch].
        overwrite: replace a bag of this name.

    Raises:
        BagError: the name is taken, or the system refuses to write.
    """
    if (last := start_ns / 1e9 + float(trajectory.t.max(initial=0.0))) >= 2**31:
        raise BagError(
            f'{trajectory.name}: its last stamp would be {last:.6g} s after 1970, and a stamp of ROS ends in 2038; '
            'mend its times'
        )
    order = np.arange(len(trajectory))
    stamps = start_ns + np.rint(trajectory.t * 1e9).astype(np.int64)
    # Times that increase by less than a nanosecond must still give stamps that increase.
    stamps = np.maximum.accumulate(stamps - order) + order
    with BagWriter(path, overwrite=overwrite) as bag:
        channel = bag.add_topic(JOINT_STATES_TOPIC, JOINT_STATE)
        for k, stamp in enumerate(stamps.tolist()):
            velocity = () if trajectory.qd is None else trajectory.qd[k]
            data = encode_joint_state(stamp, joint_names, trajectory.q[k], velocity, trajectory.tau[k])
            bag.write(channel, data, stamp, sequence=k + 1)
