# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The decoding of many JointStates at once, compared with rosbags, which decodes them one by one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pendubot_identification.errors import BagError
from pendubot_identification.recordings.joint_states import (
    JointDecoder,
    decode_joint_state,
    encode_joint_state,
    stamp_of,
)
from pendubot_identification.recordings.mcap_file import Messages

from .bags import JOINTS

numbers = st.floats(allow_nan=True, allow_infinity=True, width=64)
stamps = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)


def check(encoded, effort_names=JOINTS, expected=None):
    """Compare messages decoded at once with ``expected``, by default the same messages, decoded by rosbags."""
    states = [decode_joint_state(message) for message in expected or encoded]
    found_stamps, values = JointDecoder(JOINTS, 'bag', effort_names)(Messages.of(encoded))
    assert found_stamps.tolist() == [stamp_of(state) for state in states]
    for state, found in zip(states, values, strict=True):
        kinds = ((state.position, JOINTS), (state.effort, effort_names), (state.velocity, JOINTS))
        for row, (kind, names) in zip(found, kinds, strict=True):
            joints = [state.name.index(name) for name in names]
            np.testing.assert_array_equal(row, kind[joints] if kind.size else np.nan)


@st.composite
def messages(draw):
    """Draw JointStates of some joints in some order; some messages share their names."""
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


@settings(max_examples=40)
@given(messages(), st.sampled_from([JOINTS, ('a', 'elbow'), ('shoulder', 'a')]))
def test_messages_are_decoded_as_by_rosbags(encoded, effort_names):
    """Efforts may have separate entries."""
    incomplete = [k for k, message in enumerate(encoded) if {*effort_names} - {*decode_joint_state(message).name}]
    if incomplete:
        sentence = rf'bag, sample {incomplete[0]} has no measured current: its joints are .*, and a '
        with pytest.raises(BagError, match=sentence):
            JointDecoder(JOINTS, 'bag', effort_names)(Messages.of(encoded))
    else:
        check(encoded, effort_names)


def test_the_content_of_padding_is_ignored():
    # The serialisation of ROS leaves padding uninitialised.
    plain = [encode_joint_state(k, JOINTS, [k, 2], [3, 4], [5, k]) for k in range(3)]
    padding = plain[0].index(b'shoulder\0') + len(b'shoulder\0')
    filled = [message[:padding] + bytes([0x55, k]) + message[padding + 2 :] for k, message in enumerate(plain)]
    assert plain[0][padding : padding + 3] == bytes(3)
    check(filled, expected=plain)
