"""
Run a node, or some together, as a process: signals, allocator, spin loop, exit code.

rclpy's own signal handling shuts the context down before a node can say a last
word, so this module installs its own. A signal reaches `NodeKit.on_signal` within
a millisecond, from a thread that waits for it, whatever the executor is doing.
"""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import socket
import sys
import threading
from typing import Any, Callable, Sequence

from homography_servo.errors import ConfigError
from homography_servo.errors import HardwareError
from homography_servo.errors import ServoError
from homography_servo.nodes.executor import executor_for
from homography_servo.nodes.executor import PromptExecutor
from homography_servo.nodes.help import help_text
from homography_servo.nodes.local_topics import heard_twice
from homography_servo.nodes.local_topics import LocalTopics
from homography_servo.places import find_config
import rclpy
from rclpy.exceptions import InvalidParameterException
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.exceptions import InvalidParameterValueException
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

EXIT_OK, EXIT_FAILED, EXIT_CONFIG, EXIT_HARDWARE = 0, 1, 2, 3
_BAD_PARAMETER = (
    InvalidParameterException, InvalidParameterTypeException, InvalidParameterValueException)
_LAST_RESORT_S = 2.0
_HOOKS_S = 0.5  # that the last words of the nodes may take
PROFILE, RANGE = 'FASTRTPS_DEFAULT_PROFILES_FILE', 'ROS_AUTOMATIC_DISCOVERY_RANGE'


def tune_allocator() -> None:
    """
    Keep image-sized blocks in the heap instead of mapping each anew.

    Nearly halves the latency of images with glibc; does nothing elsewhere.
    """
    try:
        libc = ctypes.CDLL('libc.so.6')
        for option, size in ((-1, 1 << 28), (-2, 1 << 26), (-3, 1 << 25)):
            libc.mallopt(option, size)  # M_TRIM_THRESHOLD, M_TOP_PAD, M_MMAP_THRESHOLD
    except (OSError, AttributeError):
        pass


def tune_threads() -> None:
    """Keep OpenCV in one thread: the pictures are small, and other nodes wait."""
    opencv = sys.modules.get('cv2')
    if opencv is not None:
        opencv.setNumThreads(1)


def choose_transport(carries_images: bool) -> None:
    """
    Point Fast DDS to the profile for the kind of node, unless there is one of yours.

    With the discovery range LOCALHOST rmw_fastrtps adds shared memory to whatever a
    profile says, so that range is brought about by the profile itself.
    """
    if PROFILE in os.environ:
        return
    kind = 'images' if carries_images else 'commands'
    if os.environ.get(RANGE, '').upper() == 'LOCALHOST':
        kind += '_localhost'
        os.environ[RANGE] = 'SYSTEM_DEFAULT'
    os.environ[PROFILE] = str(find_config(f'fastdds_{kind}.xml'))


class SignalWatch:
    """Turn SIGINT and SIGTERM into an event and immediate calls from a thread."""

    def __init__(self) -> None:
        self.stopped = threading.Event()
        self._hooks: list[Callable[[], object]] = []
        self._reader, self._writer = socket.socketpair()
        self._writer.setblocking(False)
        signal.set_wakeup_fd(self._writer.fileno(), warn_on_full_buffer=False)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: None)
        self._thread = threading.Thread(target=self._wait, name='signals', daemon=True)
        self._thread.start()

    def on_stop(self, hook: Callable[[], object]) -> None:
        """Call a function as soon as a signal comes, or now if one has come."""
        self._hooks.append(hook)
        if self.stopped.is_set():
            hook()

    def await_hooks(self) -> None:
        """Wait until those who were called for a signal have done what they had to."""
        if self.stopped.is_set():
            self._thread.join(_HOOKS_S)

    def ignore(self) -> None:
        """Let no further signal end the process while the interpreter winds up."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)

    def _wait(self) -> None:
        while self._reader.recv(1)[0] not in (signal.SIGINT, signal.SIGTERM):
            pass
        self.stopped.set()
        for hook in list(self._hooks):
            hook()


def run_node(node_type: type, args: Sequence[str] | None = None) -> int:
    """Do as `run_nodes` with a single node."""
    return run_nodes([node_type], args, help_text(node_type))


def run_nodes(node_types: Sequence[type], args: Sequence[str] | None, about: str) -> int:
    """
    Make nodes, spin them until a signal or the end of one, and tell how it went.

    Parameters
    ----------
    node_types : sequence of type
        Node classes with `NodeKit` mixed in.
    args : list of str, optional
        Command line without the program's name.
    about : str
        What ``--help`` prints.

    Returns
    -------
    int
        0 done, 1 failed, 2 bad configuration, 3 hardware not there.

    """
    words = list(sys.argv[1:] if args is None else args)
    if {'-h', '--help'} & set(words):
        print(about)
        return EXIT_OK
    tune_allocator()
    tune_threads()
    # A command must never wait for the shared memory of a process that was killed.
    choose_transport(all(kind.CARRIES_IMAGES for kind in node_types))
    watch = SignalWatch()
    try:
        rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rcl raises its own kinds for YAML it cannot read
        return _say(error, EXIT_CONFIG)
    try:
        return _run(node_types, watch)
    finally:
        _force_exit_later()
        rclpy.try_shutdown()
        watch.ignore()


def _run(node_types: Sequence[type], watch: SignalWatch) -> int:
    topics = LocalTopics() if len(node_types) > 1 else None
    try:
        nodes = [_made(kind, topics) for kind in node_types]
        executor = _executor(nodes, topics)
    except (ConfigError, *_BAD_PARAMETER) as error:
        return _say(error, EXIT_CONFIG)
    except HardwareError as error:
        return _say(error, EXIT_HARDWARE)
    except ServoError as error:
        return _say(error, EXIT_FAILED)
    gc.collect()
    gc.freeze()  # what lives as long as the node is not looked at again: 20 ms each time
    for node in nodes:
        watch.on_stop(node.on_signal)
        node.on_finish = executor.wake
    watch.on_stop(executor.wake)
    while not watch.stopped.is_set() and all(node.exit_code is None for node in nodes):
        executor.spin_once(timeout_sec=1.0)
    watch.await_hooks()  # or a node would be destroyed while it says its last word
    for node in nodes:
        node.close()
        executor.remove_node(node)
        node.destroy_node()
    return next((node.exit_code for node in nodes if node.exit_code is not None), EXIT_OK)


def _made(kind: type, topics: LocalTopics | None) -> Any:
    """Make a node; one that shares topics with others is told so before it makes any."""
    return kind() if topics is None else type(kind.__name__, (kind,), {'local': topics})()


def _executor(nodes: list, topics: LocalTopics | None) -> SingleThreadedExecutor:
    if topics is None:
        return executor_for(nodes[0])
    if heard_twice(nodes[0]):
        raise ConfigError(os.environ[PROFILE], 0, '', 'with this profile or middleware a process '
                          'hears its own messages twice: run the nodes in a process each, or '
                          f'leave {PROFILE} to this package')
    topics.deliver()
    return PromptExecutor(nodes, topics.deliver)


def _say(error: Exception, code: int) -> int:
    print(error, file=sys.stderr, flush=True)
    return code


def _force_exit_later() -> None:
    """End the process even if the middleware's teardown hangs."""
    guard = threading.Timer(_LAST_RESORT_S, os._exit, (EXIT_FAILED,))
    guard.daemon = True
    guard.start()
