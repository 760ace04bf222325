"""Bags of several files, the room that they need, and what is repeated in each."""

import os
import resource
import shutil

import pytest
import yaml

from pendubot_identification.errors import BagError
from pendubot_identification.recordings import bag_writer
from pendubot_identification.recordings.bag_metadata import Qos
from pendubot_identification.recordings.bag_reader import BagReader, BagWindow, read_trajectory
from pendubot_identification.recordings.bag_writer import SMALLEST_FILE, BagWriter, Limits
from pendubot_identification.recordings.joint_states import JOINT_STATE
from pendubot_identification.recordings.mcap_salvage import whole_parts

from .independent import by_mcap, by_rosbags
from .test_bag_writer import START, STEP, in_another_process, message

LATCHED = Qos(durability='transient_local', depth=1)
FLOAT = bytes([0, 1, 0, 0])


def write(path, limits, count=1000, split_after=()):
    """Write a bag; return what was sent, as (topic, log time, bytes)."""
    sent = []
    with BagWriter(path, limits=limits) as bag:
        channel = bag.add_topic('/joint_states', JOINT_STATE)
        for k in range(count):
            stamp, data = message(k)
            bag.write(channel, data, stamp, sequence=k + 1)
            sent.append(('/joint_states', stamp, data))
            if k in split_after:
                assert bag.split()
    return sent


def information(path):
    return yaml.safe_load((path / 'metadata.yaml').read_text())['rosbag2_bagfile_information']


@pytest.mark.parametrize(
    ('limits', 'split_after', 'files'),
    [
        (Limits(max_duration=2.5), (), 4),
        (Limits(max_size=SMALLEST_FILE), (), 4),
        (Limits(), (10, 500, 998), 4),
        (Limits(), (999,), 1),
    ],
)
def test_a_split_bag_is_read_whole_by_everybody(tmp_path, limits, split_after, files):
    path = tmp_path / 'bag'
    sent = write(path, limits, split_after=split_after)
    assert len(list(path.glob('*.mcap'))) >= files
    assert by_mcap(path) == sent
    assert by_rosbags(path) == sent
    info = BagReader(path).info
    assert (info.count, info.closed, info.note) == (1000, True, '')
    recorded = read_trajectory(path).trajectory
    assert len(recorded) == 1000
    assert len(read_trajectory(BagWindow(path, 2.0, 8.0)).trajectory) == 600


def test_metadata_lists_every_file_with_its_own_span(tmp_path):
    path = tmp_path / 'bag'
    write(path, Limits(max_duration=2.5))
    content = information(path)
    assert content['relative_file_paths'] == [f'bag_{k}.mcap' for k in range(4)]
    assert [file['path'] for file in content['files']] == content['relative_file_paths']
    assert [file['message_count'] for file in content['files']] == [250] * 4
    starts = [file['starting_time']['nanoseconds_since_epoch'] for file in content['files']]
    assert starts == [START + 250 * k * STEP for k in range(4)]
    assert content['message_count'] == 1000
    assert content['duration']['nanoseconds'] == 999 * STEP


@pytest.mark.parametrize('max_size', [SMALLEST_FILE, 100_000])
def test_no_file_is_larger_than_allowed(tmp_path, max_size):
    write(tmp_path / 'bag', Limits(max_size=max_size), count=3000)
    sizes = [file.stat().st_size for file in (tmp_path / 'bag').glob('*.mcap')]
    assert len(sizes) > 1
    assert max(sizes) <= max_size
    # Nor is there much less in it.
    assert max(sizes) > 0.6 * max_size


def test_a_file_that_could_not_hold_its_index_is_refused(tmp_path):
    with pytest.raises(BagError, match='0 or at least 65536 bytes'):
        BagWriter(tmp_path / 'bag', limits=Limits(max_size=1000))
    assert not (tmp_path / 'bag').exists()


def test_what_is_latched_is_repeated_in_each_file(tmp_path):
    path = tmp_path / 'bag'
    with BagWriter(path) as bag:
        latched, plain = (
            bag.add_topic('/latched', 'std_msgs/msg/Float64', LATCHED),
            bag.add_topic('/plain', 'std_msgs/msg/Float64'),
        )
        for k in range(3):
            bag.write(latched, FLOAT + bytes([k] * 8), START + k, START + k, sequence=k + 1)
        bag.write(plain, FLOAT + bytes(8), START + 3, sequence=1)
        assert bag.split()
        assert not bag.split(), 'an empty file would be no file at all'
        bag.write(plain, FLOAT + bytes(8), START + 10, sequence=2)
    topics = [(topic, at - START, data[4]) for topic, at, data in by_mcap(path)]
    # In force since long ago, logged where the file begins.
    assert topics[4:] == [('/latched', 10, 2), ('/plain', 10, 0)]
    assert by_rosbags(path) == by_mcap(path)


def test_of_several_publishers_the_last_message_of_each_is_repeated(tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        latched = bag.add_topic('/latched', 'std_msgs/msg/Float64', LATCHED)
        bag.keep(latched, 2)
        for k in range(3):
            bag.write(latched, FLOAT + bytes([k] * 8), START + k)
        bag.split()
        bag.write(latched, FLOAT + bytes([9] * 8), START + 9)
    assert [data[4] for _, _, data in by_mcap(tmp_path / 'bag')] == [0, 1, 2, 1, 2, 9]


def test_a_bag_killed_after_a_split_is_read_whole(tmp_path):
    in_another_process(
        """
        for k in range(200):
            bag.write(channel, message(k)[1], message(k)[0])
            if k == 99:
                bag.split()
        bag.flush()
        os.kill(os.getpid(), signal.SIGKILL)
        """,
        tmp_path,
    )
    info = BagReader(tmp_path / 'bag').info
    assert (info.count, info.closed) == (200, False)
    assert information(tmp_path / 'bag')['relative_file_paths'] == ['bag_0.mcap', 'bag_1.mcap']


@pytest.mark.parametrize('content', [b'', b'\x89MC'])
def test_a_last_file_that_never_began_hides_no_other(tmp_path, content):
    path = tmp_path / 'bag'
    write(path, Limits(max_duration=5.0))
    (path / 'bag_1.mcap').write_bytes(content)
    info = BagReader(path).info
    assert (info.count, info.closed) == (500, False)
    assert 'bag_1.mcap' in info.note


def test_the_bag_is_closed_before_the_reserve_is_gone(tmp_path, monkeypatch):
    path = tmp_path / 'bag'
    real = os.statvfs(tmp_path)
    room = [10_000_000]
    # Stands for a disk that fills: each byte that the bag takes is gone.
    monkeypatch.setattr(
        bag_writer.os,
        'statvfs',
        lambda folder: type('Disk', (), {'f_frsize': 1, 'f_blocks': real.f_blocks, 'f_bavail': room[0] - used(path)}),
    )
    reserve = 9_500_000
    bag = BagWriter(path, limits=Limits(reserve=reserve))
    channel = bag.add_topic('/joint_states', JOINT_STATE)
    sent = []

    def write_until_refused():
        for k in range(100_000):
            stamp, data = message(k)
            sent.append(('/joint_states', stamp, data))
            bag.write(channel, data, stamp)

    with pytest.raises(BagError, match=r'is closed with all that was received before: its disk has .* MB left'):
        write_until_refused()
    assert room[0] - used(path) >= reserve
    assert room[0] - used(path) < reserve + 100_000, 'closed long before it had to be'
    assert BagReader(path).info.closed
    assert by_mcap(path) == by_rosbags(path) == sent
    with pytest.raises(BagError, match='its disk has'):
        bag.write(channel, message(0)[1], message(0)[0])


def used(path):
    return sum(file.stat().st_size for file in path.glob('*')) if path.exists() else 0


def test_a_bag_is_not_begun_where_the_reserve_is_gone_already(tmp_path):
    free = shutil.disk_usage(tmp_path).free
    with pytest.raises(BagError, match='is not begun: its disk has'):
        BagWriter(tmp_path / 'bag', limits=Limits(reserve=free + 10**9))
    assert not (tmp_path / 'bag').exists()


def test_a_reserve_is_of_the_disk_and_not_of_a_limit_on_files(tmp_path):
    full = in_another_process(
        """
        from pendubot_identification.recordings.bag_writer import Limits
        resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, 1_000_000))
        with BagWriter(Path(sys.argv[1]) / 'other', limits=Limits(reserve=2_000_000)) as other:
            other.write(other.add_topic('/joint_states', JOINT_STATE), message(0)[1], START)
        """,
        tmp_path,
    )
    assert full.stderr == ''
    assert BagReader(tmp_path / 'other').info.count == 1


def test_what_the_system_refuses_all_the_same_leaves_what_is_whole(tmp_path):
    # The writer does not see this limit coming: it is as if somebody else filled the disk at this moment, or a quota.
    full = in_another_process(
        """
        from pendubot_identification.recordings import bag_writer
        bag_writer._shortage = lambda *_: ''
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
        try:
            for k in range(10_000):
                stamp, data = message(k)
                bag.write(channel, data, stamp)
        except BagError as error:
            print(k, error)
        bag.close()
        """,
        tmp_path,
    )
    assert full.stderr == ''
    count, _, sentence = full.stdout.partition(' ')
    assert 'cannot be written (File too large); free some space' in sentence
    info = BagReader(tmp_path / 'bag').info
    assert not info.closed
    assert int(count) - 10 <= info.count <= int(count)
    assert os.path.getsize(tmp_path / 'bag' / 'bag_0.mcap') <= 100_000
    damages = []
    assert sum(1 for _ in whole_parts(tmp_path / 'bag' / 'bag_0.mcap', damages)) > 10
    assert damages == [], 'half a chunk was left at the end'
    assert information(tmp_path / 'bag')['message_count'] >= info.count
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] == resource.RLIM_INFINITY


def test_two_bags_of_one_name_at_once(tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        bag.write(bag.add_topic('/x', 'std_msgs/msg/Float64'), FLOAT + bytes(8), START)
        with pytest.raises(BagError, match='exists already'):
            BagWriter(tmp_path / 'bag')
    assert BagReader(tmp_path / 'bag').info.count == 1
