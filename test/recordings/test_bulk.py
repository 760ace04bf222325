"""Messages read many at once, against rosbags, which reads them one by one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pendubot_identification.errors import BagError
from pendubot_identification.recordings.bag_reader import BagWindow, read_trajectory
from pendubot_identification.recordings.bag_writer import BagWriter
from pendubot_identification.recordings.bulk import MESSAGE, RECORD, Layout, Message, Samples
from pendubot_identification.recordings.joint_states import (
    JOINT_STATE,
    JOINT_STATES_TOPIC,
    decode_joint_state,
    encode_joint_state,
)

CHANNEL = 3
JOINTS = ('shoulder', 'elbow')
numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)
stamps = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)


def record(data, log_ns=7, channel=CHANNEL):
    return RECORD.pack(5, MESSAGE.size + len(data)) + MESSAGE.pack(channel, 1, log_ns, log_ns) + data


@st.composite
def messages(draw):
    """JointStates of some joints in some order, all with the same names."""
    names = draw(st.permutations([*JOINTS, *draw(st.lists(st.sampled_from(['a', 'wheel', 'ä', '']), unique=True))]))
    velocities = draw(st.booleans())
    rows = st.lists(numbers, min_size=len(names), max_size=len(names))
    return [
        encode_joint_state(draw(stamps), names, draw(rows), draw(rows) if velocities else [], draw(rows))
        for _ in range(draw(st.integers(1, 6)))
    ]


@given(messages(), st.data())
def test_reads_what_rosbags_reads(encoded, data):
    others = st.sampled_from(
        [b'', record(b'another topic', channel=9), RECORD.pack(3, 2) + b'xx', record(encoded[0], 1, 9)]
    )
    chunk = b''.join(data.draw(others) + record(message, k) for k, message in enumerate(encoded))
    blocks = Layout.of(encoded[0], CHANNEL, JOINTS).read(chunk)
    assert all(isinstance(block, Samples) for block in blocks)
    expected = [decode_joint_state(message) for message in encoded]
    np.testing.assert_array_equal(np.concatenate([b.log_ns for b in blocks]), np.arange(len(encoded)))
    np.testing.assert_array_equal(np.concatenate([b.stamp_ns for b in blocks]), [e.stamp_ns for e in expected])
    values = np.concatenate([b.values for b in blocks])
    joints = [expected[0].names.index(name) for name in JOINTS]
    for k, kind in enumerate(('position', 'effort', 'velocity')):
        of_kind = np.array([getattr(e, kind) for e in expected])
        np.testing.assert_array_equal(
            values[:, k], of_kind[:, joints] if of_kind.size else np.full((len(expected), 2), np.nan)
        )


@pytest.mark.parametrize(
    'other',
    [
        encode_joint_state(1, ('elbow', 'shoulder'), [1, 2], [3, 4], [5, 6]),
        encode_joint_state(1, ('shoulder', 'elbow', 'a'), [1, 2, 3], [3, 4, 5], [5, 6, 7]),
        encode_joint_state(1, JOINTS, [1, 2], [], [5, 6]),
    ],
    ids=['names in another order, and as long', 'more joints', 'no velocities'],
)
def test_what_is_laid_out_otherwise_is_left_to_rosbags(other):
    usual = encode_joint_state(1, JOINTS, [1, 2], [3, 4], [5, 6])
    blocks = Layout.of(usual, CHANNEL, JOINTS).read(record(usual) + record(other, 8) + record(usual))
    assert Message(8, other) in blocks
    assert sum(len(b.log_ns) if isinstance(b, Samples) else 1 for b in blocks) == 3


@pytest.mark.parametrize(
    'data',
    [
        b'',
        b'\x00\x01\x00\x00',
        encode_joint_state(1, ('shoulder', 'wrist'), [1, 2], [3, 4], [5, 6]),
        encode_joint_state(1, JOINTS, [1, 2], [3, 4], []),
        encode_joint_state(1, JOINTS, [1], [3, 4], [5, 6]),
        encode_joint_state(1, JOINTS, [1, 2], [3, 4], [5, 6]) + b'more',
        b'\x00\x00' + encode_joint_state(1, JOINTS, [1, 2], [3, 4], [5, 6])[2:],
    ],
    ids=['nothing', 'a header', 'no elbow', 'no effort', 'one position', 'longer than it says', 'big-endian'],
)
def test_what_has_no_such_layout_has_none(data):
    assert Layout.of(data, CHANNEL, JOINTS) is None


def test_bytes_that_are_no_records_are_refused():
    layout = Layout.of(encode_joint_state(1, JOINTS, [1, 2], [3, 4], [5, 6]), CHANNEL, JOINTS)
    for chunk in (b'\x05', RECORD.pack(5, 10**6) + b'short'):
        with pytest.raises(BagError, match='damaged'):
            layout.read(chunk)


@pytest.mark.parametrize('closed', [True, False])
def test_a_bag_whose_messages_change_is_read_whole(tmp_path, closed):
    """Joints that change their order midway, and velocities that are missing for a while."""
    bag = BagWriter(tmp_path / 'bag')
    channel = bag.add_topic(JOINT_STATES_TOPIC, JOINT_STATE)
    for k in range(300):
        order = 1 if k < 100 else -1
        velocity = [] if 150 <= k < 200 else [0.2, 0.1][::order]
        data = encode_joint_state(k * 10**7, JOINTS[::order], [k, -k][::order], velocity, [k / 2, 0][::order])
        bag.write(channel, data, k * 10**7)
        if k % 30 == 0:
            bag.sync()
    if closed:
        bag.close()
    else:
        bag.sync()
    read = read_trajectory(BagWindow(tmp_path / 'bag', 0.5, 2.5)).trajectory
    np.testing.assert_array_equal(read.q, np.arange(50, 250)[:, None] * [1, -1])
    np.testing.assert_array_equal(read.tau, np.arange(50, 250)[:, None] * [0.5, 0])
    assert read.qd is None
    bag.close()


def test_a_joint_that_is_missing_midway_is_named(tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        channel = bag.add_topic(JOINT_STATES_TOPIC, JOINT_STATE)
        for k in range(100):
            names = JOINTS if k != 60 else ('shoulder', 'wrist')
            bag.write(channel, encode_joint_state(k * 10**7, names, [0, 0], [0, 0], [0, 0]), k * 10**7)
    with pytest.raises(BagError, match=r'sample 60 of /joint_states has no joint .elbow.'):
        read_trajectory(tmp_path / 'bag')
