# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Unclosed, truncated and damaged bags: intact messages are read and repaired, and losses are reported."""

import json
import os
import shutil

import pytest
from mcap.writer import CompressionType

from pendubot_identification.cli.main import main
from pendubot_identification.errors import BagError
from pendubot_identification.recordings.bag_reader import BagReader
from pendubot_identification.recordings.bag_repair import repair
from pendubot_identification.recordings.bag_writer import BagWriter
from test.cli.conftest import contents

from . import damage
from .bags import FLOAT, LATCHED, START, TOPIC, foreign, message
from .independent import by_mcap, by_rosbags, chunks


@pytest.fixture(autouse=True)
def without_fsync(monkeypatch):
    """Save the time of writing hundreds of bags to the disk."""
    monkeypatch.setattr(os, 'fsync', lambda _: None)


@pytest.mark.parametrize('closed', [True, False])
@pytest.mark.parametrize('alter', [damage.cut, damage.change])
def test_intact_messages_are_read_and_saved_and_losses_are_reported(tmp_path, alter, closed):
    """The benchmark of faults has a thousand of these trials."""
    for outcome, before in damage.damaged_bags(tmp_path, 6, alter, closed=closed):
        assert outcome.silent == 0
        # A wrong length hides the rest of a file without an index.
        lost = damage.CHUNK if closed or alter is damage.cut else before
        assert before - lost <= outcome.saved <= before
        assert outcome.refused or before - lost <= outcome.read <= before
        if alter is damage.cut:
            assert outcome.saved == outcome.read


PLACES = ('chunk', 'index behind it', 'first chunk')
#: Byte of a record, and its change; bytes 1 to 8 are its length.
FLIPS = ((0, 1), (1, 0x80), (2, 1), (5, 0xFF), (8, 0x80), (60, 1))


@pytest.mark.parametrize(
    ('place', 'closed', 'at', 'flip'),
    [
        *(('chunk', True, *flip) for flip in FLIPS),
        *((place, closed, *flip) for place in PLACES[1:] for closed, flip in ((True, FLIPS[3]), (False, FLIPS[5]))),
    ],
)
def test_a_damaged_chunk_loses_only_its_own_messages(tmp_path, place, closed, at, flip):
    sent = damage.write(tmp_path / 'bag', closed=closed)
    file = tmp_path / 'bag' / 'bag_0.mcap'
    found = chunks(file)
    chunk = found[0 if place == 'first chunk' else len(found) // 2]
    damage.flip(file, (chunk.end if place == 'index behind it' else chunk.begin) + at, flip)
    outcome = damage.examine(tmp_path / 'bag', tmp_path / 'copy', sent)
    assert outcome.silent == 0
    assert outcome.saved >= damage.COUNT - damage.CHUNK
    assert outcome.refused or outcome.read >= damage.COUNT - damage.CHUNK


def test_repairing_an_intact_bag_copies_it(tmp_path):
    path = tmp_path / 'bag'
    with BagWriter(path) as bag:
        latched = bag.add_topic('/latched', 'std_msgs/msg/Float64', LATCHED)
        for k in range(5):
            bag.write(latched, FLOAT + bytes([k] * 8), START + 500 * k, START + 7, sequence=k + 1)
    before = contents(path)
    (saved,) = repair(path, tmp_path / 'copy')
    assert contents(path) == before
    assert saved.intact
    assert saved.saved == {'/latched': 5}
    metadata = (path / 'metadata.yaml').read_bytes()
    assert (tmp_path / 'copy' / 'metadata.yaml').read_bytes() == metadata.replace(b'bag_', b'copy_')
    assert by_mcap(tmp_path / 'copy') == by_mcap(path) == by_rosbags(tmp_path / 'copy')


@pytest.mark.parametrize('size', [0, 20], ids=['empty', 'truncated'])
def test_a_lost_file_of_a_split_bag_is_reported(tmp_path, capsys, size):
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/other', 'std_msgs/msg/Float64')
    (tmp_path / 'bag' / 'bag_1.mcap.zstd').write_bytes(b'\x28\xb5\x2f\xfd' + bytes(size) if size else b'')
    assert main(['repair', str(tmp_path / 'bag'), '--json', '--output', str(tmp_path / 'copy')]) == 0
    report = json.loads(capsys.readouterr().out)
    assert not report['intact']
    assert [(each['closed'], bool(each['unread'])) for each in report['files']] == [(True, False), (False, True)]
    assert main(['repair', str(tmp_path / 'bag'), '--output', str(tmp_path / 'again')]) == 0
    text = capsys.readouterr().out
    assert 'bag_1.mcap.zstd' in text
    assert 'nothing was missing' not in text


@pytest.mark.parametrize(
    ('output', 'overwrite', 'size', 'sentence'),
    [
        ('bag', True, None, 'is the bag itself, inside it or contains it'),
        ('bag/inside', True, None, 'is the bag itself, inside it or contains it'),
        ('.', True, None, 'is the bag itself, inside it or contains it'),
        ('taken', False, None, 'taken exists already; give another name or'),
        ('copy', False, 40, 'no intact message'),
    ],
)
def test_a_refused_repair_is_reported_in_one_sentence_and_changes_nothing(tmp_path, output, overwrite, size, sentence):
    damage.write(tmp_path / 'bag')
    shutil.copytree(tmp_path / 'bag', tmp_path / 'taken')
    file = tmp_path / 'bag' / 'bag_0.mcap'
    file.write_bytes(file.read_bytes()[:size])
    before = contents(tmp_path)
    with pytest.raises(BagError, match=sentence):
        repair(tmp_path / 'bag', tmp_path / output, overwrite=overwrite)
    assert contents(tmp_path) == before


@pytest.mark.parametrize('closed', [True, False])
def test_a_wrong_length_in_a_chunk_without_checksum_is_detected(tmp_path, closed):
    options = {'compression': CompressionType.NONE, 'enable_crcs': False}
    file = tmp_path / 'bag.mcap'
    unclosed = foreign(file, map(message, range(300)), **options)
    found = chunks(file)
    hit = found.pop(len(found) // 2)
    if not closed:
        file.write_bytes(unclosed)
    damage.flip(file, hit.end - len(message(0)[1]) - 30, 0x40)  # the length of its last message
    reader, intact = BagReader(file), [each for chunk in found for each in chunk.messages]
    assert reader.closed == closed
    if closed:
        with pytest.raises(BagError, match=r'is damaged \d+ bytes from its start'):
            list(reader.messages([TOPIC]))
    else:
        assert f'{len(intact)} intact messages' in reader.note
        assert [(TOPIC, each.log_time, each.data) for part in reader.messages([TOPIC]) for each in part] == intact
        assert (reader.first_ns, reader.last_ns, reader.count) == (intact[0][1], intact[-1][1], len(intact))
    (saved,) = repair(file, tmp_path / 'copy')
    assert by_mcap(tmp_path / 'copy') == intact
    assert not saved.intact


def test_a_damaged_compressed_message_in_an_intact_chunk_is_detected(tmp_path):
    """The disk of the recording computer damaged it before its chunk got a checksum."""
    file = tmp_path / 'bag.mcap'
    foreign(file, ((message(k)[0], b'\x28\xb5\x2f\xfd' + bytes(20)) for k in range(300)))
    with pytest.raises(BagError, match='is damaged or changed after it was opened; copy it again from the recorder'):
        list(BagReader(file).messages([TOPIC]))


def test_a_chunk_of_zeros_is_detected(tmp_path):
    """A copy or a disk may lose a block."""
    sent = damage.write(tmp_path / 'bag')
    file = tmp_path / 'bag' / 'bag_0.mcap'
    chunk = chunks(file)[5]
    data = file.read_bytes()
    file.write_bytes(data[: chunk.begin] + bytes(chunk.end - chunk.begin) + data[chunk.end :])
    outcome = damage.examine(tmp_path / 'bag', tmp_path / 'copy', sent)
    assert outcome.refused
    assert outcome.silent == 0
    assert outcome.saved == damage.COUNT - damage.CHUNK
