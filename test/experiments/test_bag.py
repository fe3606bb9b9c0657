"""Recordings are read as they were written, and trouble with the disk ends only them."""

import errno
from pathlib import Path
import sys
import threading

from homography_servo.experiments.bag import bag_folder
from homography_servo.experiments.bag import BagError
from homography_servo.experiments.bag import read_bag
from homography_servo.experiments.bag_writer import BagSettings
from homography_servo.experiments.bag_writer import BagWriter
from homography_servo.experiments.bag_writer import Channel
from homography_servo.experiments.bag_writer import free_bytes
import numpy as np
import pytest
from rosbags.interfaces import Qos
from rosbags.interfaces import QosDurability
from rosbags.interfaces import QosHistory
from rosbags.interfaces import QosLiveliness
from rosbags.interfaces import QosReliability
from rosbags.interfaces import QosTime
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore
from rosbags.typesys import Stores
import yaml

TYPES = get_typestore(Stores.ROS2_JAZZY)
STRING, IMAGE = 'std_msgs/msg/String', 'sensor_msgs/msg/Image'
NEVER = QosTime(9223372036, 854775807)
LATCHED = Qos(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
              NEVER, NEVER, QosLiveliness.AUTOMATIC, NEVER, False)
EVENTS = Channel('/lab/servo_trial/events', STRING)
STATE = Channel('/lab/visual_servo/state', STRING, (LATCHED,))
PICTURE = Channel('/lab/image', IMAGE)
MB = 10**6
START_NS = 1_800_000_000 * 10**9


def text(words: str) -> bytes:
    """Serialise a text."""
    return bytes(TYPES.serialize_cdr(TYPES.types[STRING](data=words), STRING))


def picture(level: int, side: int = 300) -> bytes:
    """Serialise a picture, large enough to count as one."""
    kind, header = TYPES.types[IMAGE], TYPES.types['std_msgs/msg/Header']
    stamp = TYPES.types['builtin_interfaces/msg/Time'](sec=1, nanosec=2)
    data = np.full(side * side, level, np.uint8)
    return bytes(TYPES.serialize_cdr(kind(
        header=header(stamp=stamp, frame_id='camera_optical'), height=side, width=side,
        encoding='mono8', is_bigendian=0, step=side, data=data), IMAGE))


def recording(folder: Path, count: int = 5, **options) -> BagWriter:
    """Record an event, then pictures and states in turn."""
    bag = BagWriter(folder, **options)
    bag.put(EVENTS, START_NS, text('taught'))
    for k in range(count):
        bag.put(PICTURE, START_NS + k * 10**9, picture(k))
        bag.put(STATE, START_NS + k * 10**9 + 1, text(f'state {k}'))
    return bag


def states(folder: Path) -> list[str]:
    """Read the states that were recorded."""
    return [item.msg.data for item in read_bag(folder, ['visual_servo/state'])]


def metadata(folder: Path) -> dict:
    """Read metadata.yaml as any YAML reader does."""
    return yaml.safe_load((folder / 'metadata.yaml').read_text())['rosbag2_bagfile_information']


def test_messages_come_back_in_order_with_their_times_and_without_the_namespace(tmp_path):
    sentence = recording(tmp_path / 'bag').close()
    assert sentence == f'recorded 11 messages, 0 MB, in {tmp_path / "bag"}'
    found = list(read_bag(tmp_path / 'bag', ['image', 'visual_servo/state', 'not/recorded']))
    assert [item.topic for item in found] == ['image', 'visual_servo/state'] * 5
    assert [item.time_s - 1.8e9 for item in found[::2]] == pytest.approx(range(5), abs=1e-6)
    assert [item.msg.data[0] for item in found[::2]] == list(range(5))
    assert found[0].msg.header.frame_id == 'camera_optical' and found[0].msg.step == 300
    assert states(tmp_path / 'bag') == [f'state {k}' for k in range(5)]


def test_the_metadata_is_what_rosbag2_writes(tmp_path):
    recording(tmp_path / 'bag').close()
    data = metadata(tmp_path / 'bag')
    assert data['version'] == 9 and data['storage_identifier'] == 'mcap'
    assert data['relative_file_paths'] == ['bag.mcap'] and data['message_count'] == 11
    assert data['compression_mode'] == '' and data['duration']['nanoseconds'] == 4 * 10**9 + 1
    assert data['starting_time']['nanoseconds_since_epoch'] == START_NS
    topics = {item['topic_metadata']['name']: item for item in data['topics_with_message_count']}
    assert {name: item['message_count'] for name, item in topics.items()} == {
        EVENTS.topic: 1, STATE.topic: 5, PICTURE.topic: 5}
    state = topics[STATE.topic]['topic_metadata']
    assert state['type'] == STRING and state['serialization_format'] == 'cdr'
    assert state['type_description_hash'].startswith('RIHS01_')
    never = {'sec': 9223372036, 'nsec': 854775807}
    assert state['offered_qos_profiles'] == [{
        'history': 'keep_last', 'depth': 1, 'reliability': 'reliable',
        'durability': 'transient_local', 'deadline': never, 'lifespan': never,
        'liveliness': 'automatic', 'liveliness_lease_duration': never,
        'avoid_ros_namespace_conventions': False}]


def test_the_file_explains_itself_to_foxglove(tmp_path):
    recording(tmp_path / 'bag').close()
    raw = (tmp_path / 'bag' / 'bag.mcap').read_bytes()
    assert raw.startswith(b'\x89MCAP0\r\n') and raw.endswith(b'\x89MCAP0\r\n')
    with Reader(tmp_path / 'bag') as reader:
        definitions = {item.topic: item.msgdef.data for item in reader.connections}
    assert 'string data' in definitions[STATE.topic]
    assert 'uint8[] data' in definitions[PICTURE.topic]
    assert 'MSG: std_msgs/Header' in definitions[PICTURE.topic]  # with all it consists of
    assert raw.count(b'ros2msg') >= 2 and b'offered_qos_profiles' in raw


@pytest.mark.parametrize('keep_free_mb', [0.5, 500.0, 20000.0])
def test_recording_stops_when_the_disk_is_nearly_full(tmp_path, keep_free_mb):
    left, told = [keep_free_mb * MB + 3 * MB], []

    def shrinking(folder: Path) -> int:
        left[0] -= MB
        return int(left[0])

    bag = BagWriter(tmp_path / 'bag', BagSettings(keep_free_mb=keep_free_mb), free=shrinking,
                    on_stop=told.append)
    bag.put(EVENTS, START_NS, text('taught'))
    for k in range(200):
        bag.put(STATE, START_NS + k, text(f'{k} ' + 'x' * 30000))
    sentence = bag.close()
    assert f'the disk is nearly full: {keep_free_mb - 1:.0f} MB free' in sentence \
        or keep_free_mb < 1.0
    assert 'recording ended early: the disk is nearly full' in sentence
    assert told == [f'recording ended early: {bag.stopped}']
    kept = states(tmp_path / 'bag')
    assert 0 < len(kept) < 200 and len(kept) == bag.written - 1
    assert [int(item.split()[0]) for item in kept] == list(range(len(kept)))


def test_a_full_disk_at_the_start_leaves_a_bag_without_messages(tmp_path):
    bag = recording(tmp_path / 'bag', free=lambda folder: 0)
    assert 'nearly full: 0 MB free, 500 MB are kept' in bag.close()
    assert bag.written == 0 and not bag.put(STATE, 0, text('too late'))
    with pytest.raises(BagError, match='not the recording of a servo trial'):
        states(tmp_path / 'bag')


def test_a_write_that_fails_ends_the_recording_and_what_came_before_stays(tmp_path):
    told, good = [], threading.Event()
    bag = BagWriter(tmp_path / 'bag', on_stop=lambda sentence: (told.append(sentence), good.set()))
    honest = bag._bag.write

    def write(connection, time_ns, data):
        if b'state 3' in data:
            raise OSError(errno.ENOSPC, 'No space left on device')
        honest(connection, time_ns, data)

    bag._bag.write = write
    bag.put(EVENTS, START_NS, text('taught'))
    for k in range(6):
        bag.put(STATE, START_NS + k, text(f'state {k}'))
    assert good.wait(10.0)
    assert not bag.put(STATE, START_NS, text('too late'))
    sentence = bag.close()
    assert 'writing failed' in sentence and 'No space left on device' in sentence
    assert len(told) == 1 and 'cannot be played' not in sentence
    assert states(tmp_path / 'bag') == [f'state {k}' for k in range(3)]


class FullDisk:
    """A file on a disk that has room for 2.5 MB more than is held in reserve."""

    def __init__(self, file, reserve: Path) -> None:
        self._file, self._reserve = file, reserve

    def __getattr__(self, name: str):
        return getattr(self._file, name)

    def write(self, data: bytes) -> int:
        if self._reserve.exists() and self._file.tell() + len(data) > 2.5 * MB:
            self._file.write(bytes(data)[:len(data) // 2])  # a part, as real disks do
            raise OSError(errno.ENOSPC, 'No space left on device')
        return self._file.write(data)


def test_a_disk_that_is_really_full_leaves_a_bag_that_can_be_played(tmp_path):
    ended = threading.Event()
    bag = BagWriter(tmp_path / 'bag', on_stop=lambda sentence: ended.set())
    storage = bag._bag.storage
    storage.bio = FullDisk(storage.bio, tmp_path / 'bag' / '.reserve')
    bag.put(EVENTS, START_NS, text('taught'))
    for k in range(60):
        bag.put(PICTURE, START_NS + k, picture(k))
        bag.put(STATE, START_NS + k, text(f'state {k}'))
    assert ended.wait(20.0)
    assert 'No space left' in bag.close() and 'cannot be played' not in bag.stopped
    assert sorted(path.name for path in (tmp_path / 'bag').iterdir()) == [
        'bag.mcap', 'metadata.yaml']
    found = list(read_bag(tmp_path / 'bag', ['image', 'visual_servo/state']))
    assert 40 < len(found) < 120
    assert [item.msg.data[0] for item in found[::2]] == list(range(len(found[::2])))


def test_nothing_but_the_bag_is_left(tmp_path):
    recording(tmp_path / 'bag').close()
    assert sorted(path.name for path in (tmp_path / 'bag').iterdir()) == [
        'bag.mcap', 'metadata.yaml']


def test_an_end_that_cannot_be_written_is_told(tmp_path, monkeypatch):
    bag = BagWriter(tmp_path / 'bag')

    def broken() -> None:
        raise OSError(errno.EIO, 'Input/output error')

    monkeypatch.setattr(bag._bag, 'close', broken)
    bag.put(EVENTS, START_NS, text('taught'))
    assert 'has no index and cannot be played: [Errno 5]' in bag.close()
    with pytest.raises(BagError, match='no metadata.yaml'):
        states(tmp_path / 'bag')


def test_a_disk_that_hangs_holds_up_nobody_and_costs_pictures_first(tmp_path):
    hanging, asked = threading.Event(), threading.Event()

    def slow(folder: Path) -> int:
        asked.set()
        hanging.wait(30.0)
        return 10**12

    bag = BagWriter(tmp_path / 'bag', BagSettings(queue_mb=1.0), free=slow)
    bag.put(EVENTS, START_NS, text('taught'))
    assert asked.wait(10.0)  # from here on the writing thread hangs
    taken = [bag.put(PICTURE, START_NS, picture(k)) for k in range(20)]
    told = [bag.put(STATE, START_NS + k, text(f'state {k}')) for k in range(100)]
    assert taken == [True] * 8 + [False] * 12  # 0.75 MB of 90 kB each
    assert all(told) and bag.dropped == {PICTURE.topic: 12}
    hanging.set()
    sentence = bag.close()
    assert bag.written == 1 + 8 + 100 and not bag.stopped
    assert '12 left out because the disk was too slow (12 of /lab/image)' in sentence
    assert len(states(tmp_path / 'bag')) == 100


def test_closing_does_not_wait_for_a_dead_disk(tmp_path):
    hanging = threading.Event()
    bag = BagWriter(tmp_path / 'bag', free=lambda folder: hanging.wait(30.0) and 0)
    bag.put(EVENTS, START_NS, text('taught'))
    assert 'the disk did not answer' in bag.close(timeout_s=0.05)
    hanging.set()
    bag._thread.join(10.0)


def test_what_is_in_the_way_is_never_overwritten(tmp_path):
    recording(tmp_path / 'bag').close()
    before = (tmp_path / 'bag' / 'bag.mcap').read_bytes()
    with pytest.raises(BagError, match='exists already'):
        BagWriter(tmp_path / 'bag')
    (tmp_path / 'file').write_text('mine')
    with pytest.raises(BagError, match='cannot record'):
        BagWriter(tmp_path / 'file' / 'bag')
    assert (tmp_path / 'bag' / 'bag.mcap').read_bytes() == before


def test_a_bag_is_found_by_its_file_too(tmp_path):
    recording(tmp_path / 'bag').close()
    assert states(tmp_path / 'bag' / 'bag.mcap') == states(tmp_path / 'bag')
    assert bag_folder(tmp_path / 'bag' / 'metadata.yaml') == tmp_path / 'bag'


@pytest.mark.parametrize('where', ['empty', 'missing'])
def test_what_is_no_bag_is_told(tmp_path, where):
    (tmp_path / 'empty').mkdir()
    with pytest.raises(BagError, match='is not a bag: it has no metadata.yaml'):
        states(tmp_path / where)


def test_damage_gives_a_sentence_or_messages_but_nothing_else(tmp_path):
    recording(tmp_path / 'bag', count=3).close()
    file, rng, sentences = tmp_path / 'bag' / 'bag.mcap', np.random.default_rng(6), 0
    whole = file.read_bytes()
    cuts = [whole[:int(n)] for n in np.linspace(0, len(whole) - 1, 20)]
    for _ in range(60):
        garbled = bytearray(whole)
        for place in rng.integers(len(whole) - 6000, len(whole), 8):
            garbled[place] = rng.integers(256)
        cuts.append(bytes(garbled))
    for damaged in cuts:
        file.write_bytes(damaged)
        try:
            list(read_bag(tmp_path / 'bag', ['image', 'visual_servo/state']))
        except BagError as error:
            sentences += bool(str(error))
    assert sentences >= 20  # every cut, and some of the rest


def test_a_missing_library_is_told(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, 'rosbags.rosbag2', None)
    with pytest.raises(BagError, match='pip install rosbags'):
        BagWriter(tmp_path / 'bag')
    with pytest.raises(BagError, match='pip install rosbags'):
        states(tmp_path)


def test_the_room_on_the_disk_is_a_number_of_bytes(tmp_path):
    assert 0 < free_bytes(tmp_path) < 1e18
