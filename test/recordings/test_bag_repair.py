# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""What is left of bags that were killed, cut or damaged."""

import os
import shutil

import pytest

from pendubot_identification.errors import BagError
from pendubot_identification.recordings.bag_metadata import Qos
from pendubot_identification.recordings.bag_repair import repair
from pendubot_identification.recordings.bag_writer import BagWriter

from . import damage
from .independent import by_mcap, by_rosbags
from .test_bag_writer import FLOAT, START

#: A chunk holds so many messages here.
CHUNK = 11


@pytest.fixture(autouse=True)
def power_that_never_fails(monkeypatch):
    """Hundreds of bags need not be on the disk."""
    monkeypatch.setattr(os, 'fsync', lambda _: None)


def contents(folder):
    return {file: (file.read_bytes(), file.stat().st_mtime_ns) for file in folder.rglob('*') if file.is_file()}


@pytest.mark.parametrize('closed', [True, False])
def test_a_cut_bag_is_read_and_saved_up_to_the_cut(tmp_path, closed):
    saved = []
    for outcome, left in damage.damaged_bags(tmp_path, 12, damage.cut, closed=closed):
        assert outcome.silent == 0
        assert outcome.saved == outcome.read
        assert left - CHUNK < outcome.saved <= left
        saved.append(outcome.saved)
    assert max(saved) > min(saved)


@pytest.mark.parametrize('closed', [True, False])
@pytest.mark.parametrize('count', [1, 5])
def test_changed_bytes_cost_no_more_than_their_chunks_and_never_silently(tmp_path, closed, count):
    for outcome, _ in damage.damaged_bags(tmp_path, 15, lambda *of: damage.change(*of, count), closed=closed):
        assert outcome.silent == 0
        assert outcome.saved >= damage.COUNT - count * CHUNK
        assert outcome.refused or outcome.read >= damage.COUNT - count * CHUNK


def change(file, at, flip=1):
    """Change a byte of a file."""
    data = bytearray(file.read_bytes())
    data[at] ^= flip
    file.write_bytes(data)


@pytest.mark.parametrize('at', [0, 1, 2, 5, 8])
def test_a_damaged_length_leads_past_no_chunk(tmp_path, at):
    sent = damage.write(tmp_path / 'bag', closed=False)
    file = tmp_path / 'bag' / 'bag_0.mcap'
    whole = file.read_bytes()
    # Of the chunk in the middle, and of the index that follows it.
    middle = whole.index(sent[200][2])
    chunk = next(k for k in range(middle, 0, -1) if whole[k] == 6 and whole[k + 3 : k + 9] == bytes(6))
    index = chunk + 9 + int.from_bytes(whole[chunk + 1 : chunk + 9], 'little')
    assert whole[index] == 7
    for k, place in enumerate((chunk, index)):
        for m, flip in enumerate((1, 0x80, 0xFF)):
            file.write_bytes(whole)
            change(file, place + at, flip)
            outcome = damage.examine(tmp_path / 'bag', tmp_path / f'copy{k}{m}', sent)
            assert outcome.silent == 0
            assert outcome.saved >= damage.COUNT - CHUNK


def test_the_first_chunk_may_be_lost_without_the_others(tmp_path):
    sent = damage.write(tmp_path / 'bag', closed=False)
    file = tmp_path / 'bag' / 'bag_0.mcap'
    change(file, file.read_bytes().index(sent[3][2]) + 20)
    outcome = damage.examine(tmp_path / 'bag', tmp_path / 'copy', sent)
    assert (outcome.silent, outcome.refused) == (0, False)
    assert min(outcome.read, outcome.saved) >= damage.COUNT - CHUNK


def test_the_original_is_as_it_was_and_the_copy_says_all_that_it_said(tmp_path):
    path = tmp_path / 'bag'
    with BagWriter(path) as bag:
        latched = bag.add_topic('/latched', 'std_msgs/msg/Float64', Qos(durability='transient_local', depth=1))
        for k in range(5):
            bag.write(latched, FLOAT + bytes([k] * 8), START + 500 * k, START + 7, sequence=k + 1)
    metadata = (path / 'metadata.yaml').read_bytes()
    before = contents(path)
    (saved,) = repair(path, tmp_path / 'copy')
    assert contents(path) == before
    assert saved.whole
    assert saved.counts == {'/latched': 5}
    assert (tmp_path / 'copy' / 'metadata.yaml').read_bytes() == metadata.replace(b'bag_', b'copy_')
    assert by_mcap(tmp_path / 'copy') == by_mcap(path) == by_rosbags(tmp_path / 'copy')


def test_what_is_lost_is_counted(tmp_path):
    sent = damage.write(tmp_path / 'bag', closed=False)
    file = tmp_path / 'bag' / 'bag_0.mcap'
    hit = file.read_bytes().index(sent[200][2]) + 20
    change(file, hit)
    (saved,) = repair(tmp_path / 'bag', tmp_path / 'copy')
    assert not saved.whole
    assert sum(saved.counts.values()) + sum(saved.missing.values()) == damage.COUNT
    assert sum(saved.missing.values()) > 0
    (place,) = saved.damages
    assert place.offset < hit < place.offset + place.size


@pytest.mark.parametrize('output', ['bag', 'bag/inside', '.'])
def test_the_copy_is_never_the_bag(tmp_path, output):
    damage.write(tmp_path / 'bag')
    before = contents(tmp_path)
    with pytest.raises(BagError, match='is the bag itself, or in or around it'):
        repair(tmp_path / 'bag', tmp_path / output, overwrite=True)
    assert contents(tmp_path) == before


def test_nothing_is_overwritten_unless_asked(tmp_path):
    damage.write(tmp_path / 'bag')
    shutil.copytree(tmp_path / 'bag', tmp_path / 'copy')
    with pytest.raises(BagError, match='exists already'):
        repair(tmp_path / 'bag', tmp_path / 'copy')
    repair(tmp_path / 'bag', tmp_path / 'copy', overwrite=True)


def test_nothing_can_be_saved_from_nothing(tmp_path):
    path = tmp_path / 'bag'
    damage.write(path)
    (path / 'bag_0.mcap').write_bytes((path / 'bag_0.mcap').read_bytes()[:40])
    with pytest.raises(BagError, match='no message that is whole'):
        repair(path, tmp_path / 'copy')
    assert not (tmp_path / 'copy').exists()
