"""What is recorded is what was sent, and gives the report of the live trial again."""

import json
import os
from pathlib import Path
import subprocess
import sys
import time

from homography_servo.experiments.bag import ANCHOR
from homography_servo.experiments.bag import BagError
from homography_servo.experiments.bag import read_bag
from homography_servo.experiments.bag_writer import BagSettings
from homography_servo.experiments.bag_writer import BagWriter
from homography_servo.experiments.servo_trial import main
from homography_servo.experiments.trial_bag import free_folder
from homography_servo.experiments.trial_bag import trial_from_bag
from homography_servo.experiments.trial_data import as_json
from homography_servo.nodes import conversions as c
from homography_servo.nodes.kit import DEFAULT
from homography_servo.nodes.kit import images_qos
from homography_servo.nodes.kit import LATCHED
from homography_servo.nodes.recorder import ALSO_RECORDED
from homography_servo.nodes.recorder import Recorder
from homography_servo.nodes.recorder import type_name
from homography_servo.nodes.trial_client import TOPICS
from homography_servo.nodes.trial_log import TrialLog
import numpy as np
import pytest
from rosbags.typesys import get_typestore
from rosbags.typesys import Stores
from sensor_msgs.msg import Image
from std_msgs.msg import Header
from std_msgs.msg import String
from test_trial_log import run_through
import yaml

ROOT = Path(__file__).resolve().parents[2]
RECORDED = (*TOPICS, *ALSO_RECORDED)
TIMES = ('time_s', 'duration_s', 'motion_s')


class Live:
    """Hands messages to a log, and publishes them for the recorder."""

    def __init__(self, probe) -> None:
        self.log = TrialLog()
        self._probe = probe
        self._publishers = {topic: probe.publisher(kind, topic, qos)
                            for topic, kind, qos in RECORDED}

    def feed(self, topic: str, msg, time_s: float) -> None:
        """Take a message as `TrialLog.feed` does; the time is now."""
        self._publishers[topic].publish(msg)
        self.log.feed(topic, msg, time.monotonic())


@pytest.fixture
def recording(probe, tmp_path):
    """Record what the probe publishes; gives (folder, recorder, live)."""
    folder = tmp_path / 'report' / 'bag'
    recorder = Recorder(BagWriter(folder), RECORDED, context=probe.context)
    yield folder, recorder, Live(probe)
    recorder.close(0.0)


def without_times(value):
    """Leave out what is measured by a clock."""
    if isinstance(value, dict):
        return {k: without_times(v) for k, v in value.items() if k not in TIMES}
    return [without_times(item) for item in value] if isinstance(value, list) else value


def test_the_report_from_the_bag_is_that_of_the_live_trial(recording):
    folder, recorder, live = recording
    run_through(live)
    live.feed('camera_info', c.camera_info_msg(c.Camera(80, 80, 31.5, 23.5, 64, 48), Header()), 0)
    sentence = recorder.close()
    again = trial_from_bag(folder)
    expected, found = as_json(live.log.data), as_json(again.data)
    assert expected['converged'] and len(expected['poses']) == 3
    assert without_times(found) == without_times(expected)
    assert found['duration_s'] == pytest.approx(expected['duration_s'], abs=0.2)
    assert found['planned_corners_px'] == expected['planned_corners_px']
    for shot, first in zip(again.data.snapshots, live.log.data.snapshots):
        assert shot.index == first.index and np.array_equal(shot.image, first.image)
    assert again.camera() == live.log.camera() and again.camera() is not None
    assert f'in {folder}' in sentence and 'left out' not in sentence


def test_the_report_is_written_from_a_bag_without_anything_running(recording, tmp_path, capsys):
    folder, recorder, live = recording
    run_through(live)
    recorder.close()
    assert main(['--from-bag', str(folder), '--output', str(tmp_path / 'again')]) == 0
    assert 'The trial converged' in capsys.readouterr().out.splitlines()[-1]
    numbers = json.loads((tmp_path / 'again' / 'trial.json').read_text())
    assert without_times(numbers) == without_times(as_json(live.log.data))
    assert (tmp_path / 'again' / 'figure_3_joints.png').stat().st_size > 1000
    assert 'The trial converged' in (tmp_path / 'again' / 'index.html').read_text()


def test_a_recording_that_was_cut_off_is_a_failed_trial(recording, tmp_path, capsys):
    folder, recorder, live = recording
    live.feed('visual_servo/state', String(data='LOOKING'), 0.0)
    live.feed(ANCHOR, String(data='started: all is well'), 0.0)
    recorder.close(0.2)
    assert main(['--from-bag', str(folder), '--output', str(tmp_path / 'again')]) == 1
    assert capsys.readouterr().out.splitlines()[-1] == \
        'The trial did not converge: the recording ends before the trial does.'


def test_what_cannot_be_read_or_written_ends_with_2_and_a_sentence(tmp_path, capsys):
    assert main(['--from-bag', str(tmp_path)]) == 2
    assert 'is not a bag' in capsys.readouterr().err
    assert main(['--record', str(tmp_path), '--bringup', 'sim.yaml']) == 2
    assert 'exists already' in capsys.readouterr().err
    assert main(['--record', '--output', str(tmp_path), '--keep-free', '-1']) == 2
    assert 'keep_free_mb must be in' in capsys.readouterr().err
    with pytest.raises(BagError):
        trial_from_bag(tmp_path / 'nowhere')


def test_a_bag_says_what_the_publishers_offer(probe, tmp_path):
    folder = tmp_path / 'bag'
    topics = (('image', Image, images_qos(False)), ('latched', String, LATCHED),
              (ANCHOR, String, DEFAULT))
    recorder = Recorder(BagWriter(folder), topics, context=probe.context)
    image = probe.publisher(Image, 'image', images_qos(True))
    probe.publisher(String, 'latched', LATCHED).publish(String(data='here'))
    image.publish(c.image_msg(np.zeros((4, 6), np.uint8), Header()))
    probe.publisher(String, ANCHOR).publish(String(data='ended: '))
    hashes = {name: str(probe.node.get_publishers_info_by_topic(f'/{name}')[0].topic_type_hash)
              for name in ('image', 'latched')}
    recorder.close()
    data = yaml.safe_load((folder / 'metadata.yaml').read_text())
    rows = {item['topic_metadata']['name'].lstrip('/'): item['topic_metadata']
            for item in data['rosbag2_bagfile_information']['topics_with_message_count']}
    offers = {name: row['offered_qos_profiles'] for name, row in rows.items()}
    assert [len(offer) for offer in offers.values()] == [1, 1, 1]
    assert offers['image'][0]['reliability'] == 'reliable'  # as offered, not as subscribed
    assert offers['image'][0]['durability'] == 'volatile' and offers['image'][0]['depth'] == 5
    assert offers['latched'][0]['durability'] == 'transient_local'
    assert offers['latched'][0]['history'] == 'keep_last' and offers['latched'][0]['depth'] == 1
    for name, number in hashes.items():  # the definitions are those of the running ROS
        assert rows[name]['type_description_hash'] == number


def test_every_recorded_type_is_known_by_its_name():
    types = get_typestore(Stores.ROS2_JAZZY).types
    for topic, kind, _ in RECORDED:
        fields = list(types[type_name(kind)].__dataclass_fields__)
        assert [name for name in fields if name.islower() and name[0] != '_'] == \
            list(kind.get_fields_and_field_types()), topic


def test_a_full_disk_stops_the_recorder_and_not_the_others(probe, tmp_path):
    told = []
    bag = BagWriter(tmp_path / 'bag', BagSettings(keep_free_mb=1.0), free=lambda _: 0,
                    on_stop=told.append)
    recorder = Recorder(bag, RECORDED, context=probe.context)
    echo = probe.record(String, 'visual_servo/state', LATCHED)
    live = Live(probe)
    run_through(live)
    probe.wait(lambda: told and echo, 'the recording did not stop')
    live.feed('visual_servo/state', String(data='after'), 0.0)
    probe.wait(lambda: echo[-1].data == 'after', 'the others stopped')
    began_s = time.monotonic()
    assert 'recording ended early: the disk is nearly full' in recorder.close(30.0)
    assert time.monotonic() - began_s < 15.0  # nothing is waited for any more


def test_order_between_topics_is_kept_however_late_the_recorder_looks(probe, tmp_path):
    topics = ((ANCHOR, String, DEFAULT), ('joint_states', String, DEFAULT),
              ('visual_servo/state', String, DEFAULT))
    recorder = Recorder(BagWriter(tmp_path / 'bag'), topics, context=probe.context)
    publishers = [probe.publisher(String, topic) for topic, _, _ in topics]
    for k in range(9):
        publishers[[2, 1, 0][k % 3]].publish(String(data=str(k)))
    publishers[0].publish(String(data='ended'))
    recorder.close()
    found = [item.msg.data for item in read_bag(tmp_path / 'bag', [t for t, _, _ in topics])]
    assert found == [*map(str, range(9)), 'ended']


def test_names_of_recordings_do_not_run_out(tmp_path):
    assert free_folder(tmp_path / 'bag') == tmp_path / 'bag'
    for name in ('bag', 'bag_2'):
        (tmp_path / name).mkdir()
    assert free_folder(tmp_path / 'bag') == tmp_path / 'bag_3'


def test_help_shows_how_to_record():
    out = subprocess.run([sys.executable, '-m', 'homography_servo.experiments.servo_trial',
                          '--help'], cwd=ROOT, env={**os.environ, 'PYTHONPATH': str(ROOT)},
                         capture_output=True, text=True, timeout=60.0).stdout
    assert '--record' in out and 'servo_trial --from-bag report/bag' in out
