# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

import json

import pytest

from pendubot_identification.cli.main import main
from pendubot_identification.recordings.bag_reader import BagReader
from test.recordings import damage
from test.recordings.independent import by_mcap


@pytest.fixture
def killed(tmp_path, monkeypatch):
    """A bag without its end, and with a byte changed in the middle."""
    monkeypatch.chdir(tmp_path)
    sent = damage.write(tmp_path / 'swing', closed=False)
    file = tmp_path / 'swing' / 'swing_0.mcap'
    data = bytearray(file.read_bytes())
    data[data.index(sent[200][2]) + 20] ^= 1
    file.write_bytes(data)
    return tmp_path / 'swing'


def test_a_killed_bag_becomes_a_closed_copy(killed, tmp_path, capsys):
    assert main(['repair', 'swing/']) == 0
    text = capsys.readouterr().out
    assert 'swing_0.mcap: never closed, or cut' in text
    assert ' messages saved, 5 lost' in text
    assert 'are damaged and left out' in text
    assert 'swing_repaired, closed; the original is as it was' in text
    info = BagReader(tmp_path / 'swing_repaired')
    assert (info.closed, info.count) == (True, len(by_mcap(tmp_path / 'swing_repaired')))
    assert damage.COUNT - 11 <= info.count < damage.COUNT


def test_what_was_saved_is_told_to_programs(killed, capsys):
    assert main(['repair', 'swing', '--output', 'whole', '--json']) == 0
    told = json.loads(capsys.readouterr().out)
    (file,) = told['files']
    assert (told['output'], told['whole'], file['closed']) == ('whole', False, False)
    assert sum(file['saved'].values()) + sum(file['missing'].values()) == damage.COUNT
    assert [set(place) for place in file['damaged']] == [{'offset', 'size'}]


def test_a_whole_bag_is_said_to_be_whole(killed, capsys):
    assert main(['repair', 'swing']) == 0
    capsys.readouterr()
    assert main(['repair', 'swing_repaired', '--output', 'again']) == 0
    text = capsys.readouterr().out
    # What the first repair could not save is still missing.
    assert ' lost' in text
    assert 'damaged' not in text


def test_a_single_file_is_repaired_beside_itself(killed, tmp_path):
    assert main(['repair', 'swing/swing_0.mcap']) == 0
    assert BagReader(tmp_path / 'swing' / 'swing_0_repaired').closed


@pytest.mark.parametrize(
    ('arguments', 'sentence'),
    [
        (['nowhere'], 'there is no bag nowhere'),
        (['swing', '--output', 'swing', '--force'], 'is the bag itself'),
        (['swing', '--output', 'taken'], 'exists already'),
    ],
)
def test_what_cannot_be_done_is_one_sentence(killed, tmp_path, capsys, arguments, sentence):
    (tmp_path / 'taken').mkdir()
    assert main(['repair', *arguments]) == 1
    err = capsys.readouterr().err
    assert sentence in err
    assert len(err.splitlines()) == 1
