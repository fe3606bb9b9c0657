"""
Read a recording (rosbag2, MCAP or SQLite) back, message by message, without ROS.

`bag_writer` writes them; ``ros2 bag record`` does as well.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Collection, Iterator, NamedTuple

from homography_servo.errors import ServoError

ANCHOR = 'servo_trial/events'  # tells the namespace in which a trial ran


class BagError(ServoError):
    """A recording cannot be written or read."""


class BagMessage(NamedTuple):
    """One message: topic without the namespace, fields as in ROS, time of receipt."""

    topic: str
    msg: Any
    time_s: float


def bag_folder(path: Path) -> Path:
    """Give the folder of a bag that is named by its folder or by a file in it."""
    return path.parent if path.is_file() else path


def read_bag(path: Path, topics: Collection[str]) -> Iterator[BagMessage]:
    """
    Give the messages of some topics in the order in which they came.

    Parameters
    ----------
    path : path
        Folder of the bag, or the file in it.
    topics : collection of str
        Names without the namespace of the trial.

    Yields
    ------
    BagMessage
        Messages that are damaged or of a type unknown in ROS 2 Jazzy are left out.

    Raises
    ------
    BagError
        With a sentence when this is no bag, or no bag of a trial.

    """
    reader_type = _reader()
    folder = bag_folder(path)
    if not (folder / 'metadata.yaml').is_file():
        raise BagError(f'{folder} is not a bag: it has no metadata.yaml (a recording that was '
                       'cut off has none either)')
    try:
        with reader_type(folder) as reader:
            yield from _messages(reader, folder, topics)
    except BagError:
        raise
    except Exception as error:  # the library meets damage with errors of every kind
        raise BagError(f'{folder} cannot be read: {error}') from error


def _reader() -> type:
    try:
        from rosbags.rosbag2 import Reader
    except ImportError as error:
        raise BagError(missing_library(error)) from error
    return Reader


def missing_library(error: ImportError) -> str:
    """Say what to install."""
    return f'recordings need the rosbags library, 0.11 or newer: pip install rosbags ({error})'


def _messages(reader: Any, folder: Path, topics: Collection[str]) -> Iterator[BagMessage]:
    from rosbags.typesys import get_typestore
    from rosbags.typesys import Stores
    types = get_typestore(Stores.ROS2_JAZZY)
    namespace = _namespace([item.topic for item in reader.connections], folder)
    wanted = {f'{namespace}{topic}': topic for topic in topics}
    chosen = [item for item in reader.connections
              if item.topic in wanted and item.msgtype in types.types]
    for connection, time_ns, data in reader.messages(chosen) if chosen else ():
        try:
            msg = types.deserialize_cdr(data, connection.msgtype)
        except Exception:  # one damaged message is no reason to lose the others
            continue
        yield BagMessage(wanted[connection.topic], msg, 1e-9 * time_ns)


def _namespace(names: list[str], folder: Path) -> str:
    for name in names:
        if name.endswith('/' + ANCHOR):
            return name[:-len(ANCHOR)]
    raise BagError(f'{folder} is not the recording of a servo trial: it has no topic {ANCHOR}')
