"""Real-time priorities: for every thread, only where the system allows them, and given back."""

import os
import subprocess
import sys
import threading

from diagnostic_msgs.msg import DiagnosticArray
from homography_servo.nodes import scheduling
import pytest

PROBE = """
import os, threading
from homography_servo.nodes.scheduling import run_as_others, run_first
wait = threading.Event()
threads = [threading.Thread(target=wait.wait) for _ in range(3)]
for thread in threads:
    thread.start()
def policies():
    return {os.sched_getscheduler(int(entry)) for entry in os.listdir('/proc/self/task')}
print(run_first(7), policies() == {os.SCHED_FIFO}, os.sched_getparam(0).sched_priority, sep='|')
run_as_others()
print(policies() == {os.SCHED_OTHER})
wait.set()
"""


def allowed():
    """Tell whether this system lets us have a real-time priority (as root, or by a limit)."""
    code = 'import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))'
    return len(os.sched_getaffinity(0)) > 1 and subprocess.run(
        [sys.executable, '-c', code], stderr=subprocess.DEVNULL).returncode == 0


def test_every_thread_gets_the_priority_and_gives_it_back():
    if not allowed():
        pytest.skip('this system does not allow real-time priorities')
    done = subprocess.run([sys.executable, '-c', PROBE], capture_output=True, text=True,
                          check=True)
    assert done.stdout.split() == ['SCHED_FIFO', '7|True|7', 'True']


def forbid(monkeypatch, error):
    """Let the system refuse; give the list of what was asked for."""
    asked = []

    def refuse(thread, policy, param):
        asked.append((thread, policy, param.sched_priority))
        raise error
    monkeypatch.setattr(os, 'sched_setscheduler', refuse)
    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: {0, 1})
    return asked


def test_a_refusal_is_a_sentence(monkeypatch):
    asked = forbid(monkeypatch, PermissionError(1, 'not permitted'))
    assert 'allows no real-time priorities (not permitted)' in scheduling.run_first(50)
    assert asked[0][1:] == (os.SCHED_FIFO, 50) and len(asked) == 1


def test_a_thread_that_has_ended_is_passed_over(monkeypatch):
    asked = forbid(monkeypatch, ProcessLookupError())
    assert scheduling.run_first(50) == 'SCHED_FIFO 50'
    assert len(asked) >= threading.active_count()


@pytest.mark.parametrize('priority, cores, why', [(0, {0, 1}, 'is 0'), (50, {0}, 'one core')])
def test_nothing_is_asked_for(priority, cores, why, monkeypatch):
    asked = forbid(monkeypatch, AssertionError())
    monkeypatch.setattr(os, 'sched_getaffinity', lambda _: cores)
    assert why in scheduling.run_first(priority)
    assert not asked


@pytest.mark.parametrize('name, priority', [('robix_bridge', 60), ('path_planner', 50)])
def test_the_diagnostics_tell_how_a_node_is_scheduled(name, priority, start_node, probe):
    heard = probe.record(DiagnosticArray, '/diagnostics')
    node = start_node(name)

    def said():
        return [status.message for message in heard for status in message.status
                if status.name == f'{name}: process']
    probe.wait(said, 'the node tells how it is scheduled')
    policy = os.sched_getscheduler(node.process.pid)
    expected = f'SCHED_FIFO {priority}' if policy == os.SCHED_FIFO else 'as any other'
    assert said()[0].startswith(expected)
    assert (policy == os.SCHED_FIFO) == allowed()


def test_the_bridge_comes_before_those_it_obeys():
    assert scheduling.BridgeScheduling().realtime_priority \
        > scheduling.SchedulingSettings().realtime_priority > 0
