"""A trial onto a recording, and from a recording alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from homography_servo.experiments.bag import ANCHOR
from homography_servo.experiments.bag import BagError
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


def begin_bag(wanted: str, output: Path, keep_free_mb: float) -> Any:
    """
    Begin a recording.

    Parameters
    ----------
    wanted : str
        Folder; empty for one in the output folder.
    output : path
        Where the report will be.
    keep_free_mb : float
        Free disk space at which recording stops.

    Raises
    ------
    BagError
        When nothing can be recorded there.

    """
    from homography_servo.experiments.bag_writer import BagSettings
    from homography_servo.experiments.bag_writer import BagWriter
    try:
        settings = BagSettings(keep_free_mb=keep_free_mb)
    except ValueError as error:
        raise BagError(f'--keep-free: {error}') from error
    folder = Path(wanted) if wanted else free_folder(output / 'bag')
    return BagWriter(folder, settings, on_stop=lambda sentence: print(sentence, flush=True))


def recorder_of(bag: Any) -> Any:
    """Subscribe on behalf of a recording; needs the rosbags library, as the recording does."""
    from homography_servo.nodes.recorder import ALSO_RECORDED
    from homography_servo.nodes.recorder import Recorder
    return Recorder(bag, (*TOPICS, *ALSO_RECORDED))
