"""The dashboard in a real browser: what a person sees, and that the buttons work."""

from pathlib import Path
import re
import sys
import time
from urllib.request import urlopen

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('tornado', reason='the dashboard needs tornado (python3-tornado)')
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / 'tools'))

from browser import Browser  # noqa: E402,I100
from browser import find_browser  # noqa: E402
from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from diagnostic_msgs.msg import KeyValue  # noqa: E402
from homography_servo.nodes.conversions import image_msg  # noqa: E402
from homography_servo.nodes.conversions import image_path_msg  # noqa: E402
from homography_servo.nodes.conversions import joint_state_msg  # noqa: E402
from homography_servo.nodes.conversions import trajectory_msg  # noqa: E402
from homography_servo.nodes.kit import images_qos  # noqa: E402
from homography_servo.nodes.kit import LATCHED  # noqa: E402
from homography_servo.places import find_config  # noqa: E402
from homography_servo.robot.robot_file import load_robot  # noqa: E402
from sensor_msgs.msg import Image  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from std_msgs.msg import String  # noqa: E402
from std_srvs.srv import SetBool  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from trajectory_msgs.msg import JointTrajectory  # noqa: E402

STOP_S = 0.3
IMAGES = 'snake_tracker/annotated_image'
NAMES = [f'joint{k + 1}' for k in range(6)]


class Cell:
    """The other nodes, played by the probe: messages out, services counted."""

    def __init__(self, probe) -> None:
        self.probe, self.pressed, self.frame = probe, [], 0
        node = probe.node
        for name in ('path_planner/teach_goal', 'path_planner/plan', 'visual_servo/start',
                     'visual_servo/stop', 'robix_bridge/stop', 'robix_bridge/reset'):
            node.create_service(Trigger, name, lambda _, answer, name=name: self._press(
                name, True, answer))
        node.create_service(SetBool, 'visual_servo/pause', lambda request, answer: self._press(
            'visual_servo/pause', request.data, answer))
        self.images = node.create_publisher(Image, IMAGES, images_qos(False))
        self.joints = node.create_publisher(JointState, 'joint_states', 10)
        self.diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self.progress = node.create_publisher(DiagnosticStatus, 'visual_servo/progress', 10)
        self.states = {name: node.create_publisher(String, f'{name}/state', LATCHED)
                       for name in ('visual_servo', 'robix_bridge', 'snake_tracker')}
        self.path = node.create_publisher(Float64MultiArray, 'path/image', LATCHED)
        self.verdict = node.create_publisher(DiagnosticArray, 'path/verdict', LATCHED)
        self.talks = True
        node.create_timer(1 / 30, self._show)
        node.create_timer(0.5, self._diagnose)

    def _press(self, name, value, answer):
        self.pressed.append((name, value, time.monotonic()))
        answer.success, answer.message = name != 'path_planner/plan', f'{name} <b>did</b> it'
        return answer

    def _show(self) -> None:
        self.frame += 1
        header = Header(stamp=self.probe.stamp())
        pixels = np.full((240, 320, 3), 40, np.uint8)
        left = 3 * self.frame % 200
        pixels[80:160, left:left + 100] = 200
        if self.images.get_subscription_count():
            self.images.publish(image_msg(pixels, header))
        self.joints.publish(joint_state_msg(NAMES, np.sin(self.frame / 40 + np.arange(6)),
                                            header))

    def tell(self) -> None:
        """Say what the other nodes say once or once a second."""
        states = ('LOOKING', 'IDLE', 'TRACKING')
        for publisher, state in zip(self.states.values(), states):
            publisher.publish(String(data=state))
        self.progress.publish(status(
            'visual_servo: progress', b'\0', 'LOOKING', pose=2, of=3, iterations=4,
            position_error_m=0.0123, rotation_error_rad=float('nan')))
        path_px = np.array([[[u, v], [u + 90, v], [u + 90, v + 60], [u, v + 60]]
                            for u, v in ((20, 30), (60, 80), (150, 120))], dtype=float)
        self.path.publish(image_path_msg(path_px))
        self.verdict.publish(DiagnosticArray(status=[
            status('path_planner: path', b'\2', 'pose 3: a corner leaves the image'),
            status('path_planner: pose 1', b'\0', 'ok', border_px=50.4, joint_margin_rad=0.1),
            status('path_planner: pose 2', b'\0', 'ok', border_px=31.0),
            status('path_planner: pose 3', b'\2', '<img src=x> outside', border_px=-4.0)]))

    def _diagnose(self) -> None:
        if self.talks:
            self.diagnostics.publish(DiagnosticArray(status=[
                status('robix_bridge: link', b'\1', 'two bytes were lost', bytes_lost=2)]))


def status(name: str, level: bytes, message: str, **values) -> DiagnosticStatus:
    """Make a status."""
    return DiagnosticStatus(name=name, level=level, message=message, values=[
        KeyValue(key=key, value=str(value)) for key, value in values.items()])


@pytest.fixture(scope='module')
def shared_browser():
    if find_browser() is None:
        pytest.skip('no Chromium on this machine (Debian: apt install chromium)')
    made = Browser()
    yield made
    made.close()


@pytest.fixture
def browser(shared_browser):
    shared_browser.errors.clear()
    shared_browser.resize(1280, 900)
    yield shared_browser
    shared_browser.command('Page.navigate', url='about:blank')


def url_of(node, probe) -> str:
    """Wait for the dashboard and give its address."""
    found = probe.wait(lambda: re.search(r'http://127\.0\.0\.1:\d+/', node.output),
                       f'no address: {node.output}')
    return found.group()


@pytest.fixture
def cell(probe, start_node):
    """Give the played cell with a dashboard beside it, ready for a browser."""
    made = Cell(probe)
    made.node = start_node('dashboard', port=0)
    made.url = url_of(made.node, probe)
    probe.wait(lambda: all(p.get_subscription_count() for p in made.states.values()),
               'the dashboard does not listen')
    made.tell()
    return made


def say(cell, browser, selector: str, wanted: str) -> None:
    """Wait until an element shows some text."""
    cell.probe.wait(lambda: wanted in browser.text(selector),
                    f'{selector} does not say {wanted!r} but {browser.text(selector)!r}')


def test_the_page_shows_moving_pictures_and_all_there_is_to_know(cell, browser):
    probe = cell.probe
    assert not probe.node.count_subscribers(IMAGES)
    browser.open(cell.url)
    frames = 'Number(document.body.dataset.frames || 0)'
    probe.wait(lambda: browser.run(frames) > 3, 'no pictures')
    looks = {probe.wait(lambda: browser.run(
        f'{frames} > {k} && document.getElementById("view").toDataURL()'), 'no more pictures')
        for k in (5, 10, 15)}
    assert len(looks) == 3
    assert browser.run('getComputedStyle(document.getElementById("no-picture")).display') == 'none'
    say(cell, browser, '#state-visual_servo', 'LOOKING')
    say(cell, browser, '#state-snake_tracker', 'TRACKING')
    say(cell, browser, '#verdict-sentence', 'pose 3: a corner leaves the image')
    say(cell, browser, '#target', 'to pose 2 of 3, move 4')
    say(cell, browser, '#verdict-table tr.here', '2')
    cell.progress.publish(status('visual_servo: progress', b'\0', 'MOVING', pose=2, of=3,
                                 reached='true', position_error_m=0.0123))
    say(cell, browser, '#target', 'to pose 3 of 3')
    say(cell, browser, '#verdict-table tr.here', '3')
    say(cell, browser, '#verdict-table tr.error', '<img src=x> outside')
    say(cell, browser, '#node-robix_bridge', 'two bytes were lost')
    say(cell, browser, '#legend-joints', 'joint6')
    assert browser.run('document.querySelectorAll("#verdict-table tbody tr").length') == 3
    for plot in ('joints', 'position'):
        probe.wait(lambda: coloured(browser, f'plot-{plot}', '0072b2') > 20, f'no curve in {plot}')
    assert coloured(browser, 'plot-rotation', '0072b2') == 0  # not a number: no curve
    cell.talks = False
    say(cell, browser, '#node-robix_bridge', 'silent')
    assert not browser.errors


def coloured(browser, canvas: str, color: str) -> int:
    """Count the pixels of a canvas that have about a colour."""
    wanted = [int(color[k:k + 2], 16) for k in (0, 2, 4)]
    return browser.run(f"""(() => {{ const c = document.getElementById('{canvas}');
        const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; let n = 0;
        for (let k = 0; k < d.length; k += 4) n += d[k + 3] > 200 && [{wanted}].every(w =>
            w.every((v, j) => Math.abs(v - d[k + j]) < 30)); return n; }})()""")


def test_the_path_lies_on_the_picture_and_can_be_hidden(cell, browser):
    browser.open(cell.url)
    # The target's outline runs through (60, 80) to (150, 80) of an image 320 px wide.
    there = """(() => { const c = document.getElementById('view'), s = c.width / 320;
        const d = c.getContext('2d').getImageData(Math.round(105 * s),
            Math.round(80.5 * s) - 3, 1, 7).data;
        for (let k = 0; k < 28; k += 4)
            if (d[k] > 220 && d[k + 1] > 170 && d[k + 2] < 150) return true;
        return false; })()"""
    cell.probe.wait(lambda: browser.run(there), 'the target is not drawn where it is')
    browser.click('#show-path')
    cell.probe.wait(lambda: not browser.run(there), 'the path does not go away')


def test_pictures_are_asked_for_only_while_somebody_looks(cell, browser):
    probe = cell.probe
    watched = lambda: probe.node.count_subscribers(IMAGES) > 0  # noqa: E731
    browser.open(cell.url)
    probe.wait(watched, 'nobody asks for pictures')
    browser.command('Page.navigate', url='about:blank')
    probe.wait(lambda: not watched(), 'pictures are still asked for')
    browser.open(cell.url)
    probe.wait(watched, 'nobody asks for pictures any more')


def test_the_rate_of_pictures_is_limited(cell, browser):
    probe = cell.probe
    browser.open(cell.url)
    frames = 'Number(document.body.dataset.frames || 0)'
    probe.wait(lambda: browser.run(frames) > 3, 'no pictures')
    first, began_s = browser.run(frames), time.monotonic()
    probe.spin_for(3.0)
    rate_hz = (browser.run(frames) - first) / (time.monotonic() - began_s)
    assert 5.0 < rate_hz < 17.0, rate_hz


def test_each_button_does_what_it_says_once_and_tells_the_answer(cell, browser):
    browser.open(cell.url)
    say(cell, browser, '#state-robix_bridge', 'IDLE')
    for button, calls in (
            ('teach_goal', ['path_planner/teach_goal']), ('plan', ['path_planner/plan']),
            ('start', ['visual_servo/start']), ('pause', ['visual_servo/pause']),
            ('stop', ['robix_bridge/stop', 'visual_servo/stop'])):
        browser.click(f'[data-press={button}]')
        say(cell, browser, '#answer', f'{calls[0]} <b>did</b> it')
        cell.probe.spin_for(0.1)
        assert sorted(name for name, *_ in cell.pressed) == calls
        assert all(value for _, value, _ in cell.pressed)
        level = 'error' if button == 'plan' else 'ok'  # the played planner refuses
        assert browser.run('document.getElementById("answer").className') == level
        cell.pressed.clear()


def test_pause_becomes_go_on_and_a_latched_arm_can_be_reset(cell, browser):
    browser.open(cell.url)
    say(cell, browser, '#state-robix_bridge', 'IDLE')
    assert browser.run('document.querySelector("[data-press=reset_arm]").hidden')
    cell.states['visual_servo'].publish(String(data='HOLD: paused by the operator'))
    cell.states['robix_bridge'].publish(String(data='LATCHED: the line was cut'))
    say(cell, browser, '#buttons', 'Go on')
    say(cell, browser, '#buttons', 'Reset arm')
    browser.click('[data-press=go_on]')
    browser.click('[data-press=reset_arm]')
    cell.probe.wait(lambda: len(cell.pressed) == 2, 'no call')
    assert {call[:2] for call in cell.pressed} == {
        ('visual_servo/pause', False), ('robix_bridge/reset', True)}


def test_stop_reaches_servo_and_arm_within_the_time(cell, browser):
    browser.open(cell.url)
    say(cell, browser, '#state-robix_bridge', 'IDLE')
    browser.run('document.querySelector("[data-press=stop]").focus()')
    for way in ('mouse', 'Escape', 'Enter'):
        began_s = time.monotonic()
        if way == 'mouse':
            browser.click('[data-press=stop]')
        else:
            key = {'key': way} if way == 'Escape' else {
                'key': way, 'text': '\r', 'windowsVirtualKeyCode': 13}
            browser.command('Input.dispatchKeyEvent', type='keyDown', **key)
            browser.command('Input.dispatchKeyEvent', type='keyUp', **key)
        cell.probe.wait(lambda: len(cell.pressed) == 2, f'no stop by {way}')
        assert max(at_s for *_, at_s in cell.pressed) - began_s < STOP_S
        assert {name for name, *_ in cell.pressed} == {'robix_bridge/stop', 'visual_servo/stop'}
        cell.pressed.clear()


def test_stop_works_where_only_the_arm_is_there_and_says_who_is_missing(
        probe, start_node, browser):
    called = []
    probe.node.create_service(Trigger, 'robix_bridge/stop',
                              lambda _, answer: called.append(1) or answer)
    url = url_of(start_node('dashboard', port=0), probe)
    browser.open(url)
    probe.wait(lambda: browser.click('[data-press=stop]') or probe.spin_for(0.1) or called,
               'the arm was not told')
    probe.wait(lambda: 'visual_servo: is not there' in browser.text('#answer'), 'says nothing')


def test_the_page_goes_on_after_a_restart_of_the_dashboard(cell, start_node, browser):
    browser.open(cell.url)
    say(cell, browser, '#state-visual_servo', 'LOOKING')
    token = browser.run('document.querySelector("meta[name=token]").content')
    assert cell.node.stop() == 0, cell.node.output
    cell.probe.wait(lambda: not browser.run('document.getElementById("lost").hidden'),
                    'the page does not say that it is cut off')
    start_node('dashboard', port=int(cell.url.rstrip('/').rsplit(':', 1)[1]))
    cell.probe.wait(lambda: browser.run(
        '(document.querySelector("meta[name=token]") || {}).content') not in (token, None),
        'no new token')
    say(cell, browser, '#state-visual_servo', 'LOOKING')
    browser.click('[data-press=stop]')
    cell.probe.wait(lambda: len(cell.pressed) == 2, 'stop does not work any more')


def test_nothing_sticks_out_and_stop_is_in_sight(cell, browser):
    for width in (1280, 390):
        browser.resize(width, 800, mobile=width < 500)
        browser.open(cell.url)
        say(cell, browser, '#verdict-sentence', 'pose 3')
        assert browser.run('document.documentElement.scrollWidth') <= width
        left, right, top, bottom = browser.run(
            '(() => { const r = document.querySelector("[data-press=stop]")'
            '.getBoundingClientRect(); return [r.left, r.right, r.top, r.bottom]; })()')
        assert 0 <= left < right <= width and 0 <= top < bottom <= 800


def test_a_taken_port_is_told_in_a_sentence(probe, start_node):
    port = int(url_of(start_node('dashboard', port=0), probe).rstrip('/').rsplit(':', 1)[1])
    second = start_node('dashboard', port=port)
    assert second.wait() == 2
    assert 'cannot listen on 127.0.0.1' in second.output and 'Traceback' not in second.output


def test_a_restarted_dashboard_shows_what_was_said_before(cell, start_node, browser):
    again = start_node('dashboard', '--ros-args', '-r', '__node:=second', '-p', 'port:=0')
    browser.open(url_of(again, cell.probe))
    say(cell, browser, '#verdict-sentence', 'pose 3: a corner leaves the image')
    say(cell, browser, '#state-visual_servo', 'LOOKING')


def test_stop_stops_the_arm(probe, start_node, browser):
    """The real bridge and emulator: the arm stands 0.3 s after the click."""
    robot = load_robot(find_config('robix_rcs6.yaml'))
    start_node('robix_bridge', port='fake')
    url = url_of(start_node('dashboard', port=0), probe)
    states = probe.record(JointState, 'joint_states')
    commands = probe.publisher(JointTrajectory, 'joint_trajectory', 1)
    browser.open(url)
    probe.wait(lambda: browser.text('#state-robix_bridge') == 'IDLE', 'the arm is not ready')
    here = np.array(probe.wait(lambda: states, 'no joint states')[-1].position)
    away = np.where(here > 0.0, here - 0.8, here + 0.8)
    commands.publish(trajectory_msg(robot.joint_names, [away], [5.0]))
    probe.wait(lambda: abs(np.array(states[-1].position) - here).max() > 0.1, 'it does not move')
    began_s = time.monotonic()
    browser.click('[data-press=stop]')
    probe.spin_for(STOP_S - (time.monotonic() - began_s))
    stopped = np.array(states[-1].position)
    probe.spin_for(0.5)
    assert abs(np.array(states[-1].position) - stopped).max() < 1e-3
    assert abs(stopped - away).max() > 0.2


def test_the_page_is_served_to_this_machine_only(cell):
    assert urlopen(cell.url).status == 200
    assert '127.0.0.1' in cell.url
