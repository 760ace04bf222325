# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""JointStates read many at once, against rosbags, which reads them one by one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from pendubot_identification.errors import BagError
from pendubot_identification.recordings.bag_reader import BagWindow, read_trajectory
from pendubot_identification.recordings.bag_writer import BagWriter
from pendubot_identification.recordings.joint_states import (
    JOINT_STATE,
    JOINT_STATES_TOPIC,
    JointDecoder,
    decode_joint_state,
    encode_joint_state,
    stamp_of,
)
from pendubot_identification.recordings.mcap_file import FIELDS, MESSAGE, parse_records

JOINTS = ('shoulder', 'elbow')
numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)
stamps = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)


def record(data, channel=1):
    head = np.array((5, FIELDS + len(data), channel, 1, 7, 7), MESSAGE)
    return head.tobytes() + data


def decoded(*messages):
    """Decode messages that stand together."""
    _, found = parse_records(b''.join(map(record, messages)))
    return JointDecoder(JOINTS, 'bag')(found)


def expected(*messages):
    """The same, as rosbags reads them."""
    states = [decode_joint_state(message) for message in messages]
    values = np.full((len(states), 3, 2), np.nan)
    for k, state in enumerate(states):
        joints = [state.name.index(name) for name in JOINTS]
        for row, kind in enumerate((state.position, state.effort, state.velocity)):
            if kind.size:
                values[k, row] = kind[joints]
    return np.array([stamp_of(state) for state in states]), values


@st.composite
def messages(draw):
    """JointStates of some joints in some order, some with the same names as those before."""
    found = []
    for _ in range(draw(st.integers(1, 3))):
        names = draw(st.permutations([*JOINTS, *draw(st.lists(st.sampled_from(['a', 'wheel', 'ä', '']), unique=True))]))
        velocities, frame = draw(st.booleans()), draw(st.sampled_from(['', 'base']))
        rows = st.lists(numbers, min_size=len(names), max_size=len(names))
        found += [
            encode_joint_state(draw(stamps), names, draw(rows), draw(rows) if velocities else [], draw(rows), frame)
            for _ in range(draw(st.integers(1, 4)))
        ]
    return draw(st.permutations(found))


@given(messages())
def test_reads_messages_like_rosbags(encoded):
    for one, other in zip(decoded(*encoded), expected(*encoded), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_content_of_padding_is_ignored():
    # ROS's own serialisation leaves there what was in memory before.
    plain = [encode_joint_state(k, JOINTS, [k, 2], [3, 4], [5, k]) for k in range(3)]
    padding = plain[0].index(b'shoulder\0') + len(b'shoulder\0')
    filled = [message[:padding] + bytes([0x55, k]) + message[padding + 2 :] for k, message in enumerate(plain)]
    assert plain[0][padding : padding + 3] == bytes(3)
    for one, other in zip(decoded(*filled), expected(*plain), strict=True):
        np.testing.assert_array_equal(one, other)


@given(messages(), st.sampled_from([('a', 'elbow'), ('shoulder', 'a')]))
def test_efforts_are_read_from_separate_entries(encoded, effort_names):
    _, found = parse_records(b''.join(map(record, encoded)))
    states = [decode_joint_state(message) for message in encoded]
    lacking = [k for k, state in enumerate(states) if 'a' not in state.name]
    if lacking:
        with pytest.raises(
            BagError, match=rf'bag, sample {lacking[0]} has no measured current: its joints are .*, and a '
        ):
            JointDecoder(JOINTS, 'bag', effort_names)(found)
        return
    _, values = JointDecoder(JOINTS, 'bag', effort_names)(found)
    np.testing.assert_array_equal(values[:, [0, 2]], expected(*encoded)[1][:, [0, 2]])
    efforts = [[state.effort[state.name.index(name)] for name in effort_names] for state in states]
    np.testing.assert_array_equal(values[:, 1], efforts)


@pytest.mark.parametrize('data', [b'', b'\x00\x01\x00\x00', b'\x00\x01\x00\x00' + b'\xff' * 100])
def test_invalid_joint_states_are_one_sentence(data):
    with pytest.raises(BagError, match='is no sensor_msgs/msg/JointState'):
        decoded(data)


def test_a_bag_with_changing_messages_is_read(tmp_path):
    """Joints that change their order midway, velocities that are missing for a while, a joint missing at the end."""
    with BagWriter(tmp_path / 'bag') as bag:
        channel = bag.add_topic(JOINT_STATES_TOPIC, JOINT_STATE)
        for k in range(300):
            order = 1 if k < 100 else -1
            names = JOINTS[::order] if k < 290 else ('shoulder', 'wrist')
            velocity = [] if 150 <= k < 200 else [0.2, 0.1][::order]
            data = encode_joint_state(k * 10**7, names, [k, -k][::order], velocity, [k / 2, 0][::order])
            bag.write(channel, data, k * 10**7)
    read = read_trajectory(BagWindow(tmp_path / 'bag', 0.5, 1.8)).trajectory
    np.testing.assert_array_equal(read.q, np.arange(50, 180)[:, None] * [1, -1])
    np.testing.assert_array_equal(read.tau, np.arange(50, 180)[:, None] * [0.5, 0])
    assert read.qd is None
    assert read_trajectory(BagWindow(tmp_path / 'bag', 0.5, 1.4)).trajectory.qd is not None
    with pytest.raises(BagError, match=r'/joint_states, sample 290 has no joint .elbow.'):
        read_trajectory(tmp_path / 'bag')


def test_the_other_byte_order_is_read_too():
    store, encoded = get_typestore(Stores.ROS2_JAZZY), []
    types = store.types
    for k in range(3):
        header = types['std_msgs/msg/Header'](types['builtin_interfaces/msg/Time'](0, k), '')
        message = types[JOINT_STATE](header, list(JOINTS), *np.array([[k, 1], [2, 3], [4, 5]], float))
        encoded.append(bytes(store.serialize_cdr(message, JOINT_STATE, little_endian=False)))
    encoded.insert(1, encode_joint_state(9, JOINTS, [6, 7], [8, 9], [10, 11]))
    for one, other in zip(decoded(*encoded), expected(*encoded), strict=True):
        np.testing.assert_array_equal(one, other)
