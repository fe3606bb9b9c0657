"""A trial from its recording alone."""

from __future__ import annotations

from pathlib import Path

from homography_servo.experiments.bag import ANCHOR
from homography_servo.experiments.bag import read_bag
from homography_servo.nodes.trial_client import TOPICS
from homography_servo.nodes.trial_log import ENDED
from homography_servo.nodes.trial_log import TrialLog

CUT = 'failed: the recording ends before the trial does'


def trial_from_bag(path: Path) -> TrialLog:
    """
    Feed a recording to the log that follows a live trial.

    Raises
    ------
    BagError
        When there is no recording of a trial.

    """
    log, time_s, ended = TrialLog(), 0.0, False
    for topic, msg, time_s in read_bag(path, [ANCHOR, *(topic for topic, _, _ in TOPICS)]):
        log.feed(topic, msg, time_s)
        ended = ended or (topic == ANCHOR and msg.data.startswith(ENDED))
    if not ended:
        log.finish(CUT, time_s)
    return log


def free_folder(wanted: Path) -> Path:
    """Give a folder name that is not taken: the one wanted, or with a number behind it."""
    folder, number = wanted, 1
    while folder.exists():
        number += 1
        folder = wanted.with_name(f'{wanted.name}_{number}')
    return folder
