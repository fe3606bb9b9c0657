"""The parts of the dashboard: who may talk to it, what browsers get, messages as facts."""

import asyncio
import json
import re
import socket
import time

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2')
pytest.importorskip('tornado', reason='the dashboard needs tornado (python3-tornado)')

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402,I100
from diagnostic_msgs.msg import DiagnosticStatus  # noqa: E402
from diagnostic_msgs.msg import KeyValue  # noqa: E402
from homography_servo.launch import bringup  # noqa: E402
from homography_servo.nodes import dashboard_facts as facts  # noqa: E402
from homography_servo.nodes.conversions import image_msg  # noqa: E402
from homography_servo.nodes.dashboard_board import Board  # noqa: E402
from homography_servo.nodes.dashboard_guard import host_allowed  # noqa: E402
from homography_servo.nodes.dashboard_guard import origin_allowed  # noqa: E402
from homography_servo.nodes.dashboard_guard import same_token  # noqa: E402
from homography_servo.nodes.dashboard_server import Answer  # noqa: E402
from homography_servo.nodes.dashboard_server import BROWSERS  # noqa: E402
from homography_servo.nodes.dashboard_server import DashboardServer  # noqa: E402
from homography_servo.nodes.dashboard_server import WEB  # noqa: E402
from homography_servo.result import Rejected  # noqa: E402
from sensor_msgs.msg import JointState  # noqa: E402
from std_msgs.msg import Float64MultiArray  # noqa: E402
from std_msgs.msg import Header  # noqa: E402
from std_msgs.msg import MultiArrayDimension  # noqa: E402
from tornado.httpclient import AsyncHTTPClient  # noqa: E402
from tornado.httpclient import HTTPClientError  # noqa: E402
from tornado.httpclient import HTTPRequest  # noqa: E402
from tornado.ioloop import PeriodicCallback  # noqa: E402
from tornado.websocket import websocket_connect  # noqa: E402


# How it is started.

def test_bringup_adds_it_with_its_parameters(capsys):
    words = ['--config', 'sim.yaml', '--dashboard', '--print-config']
    assert bringup.main([*words, '--only', 'camera_sim', '--set', 'dashboard.port:=0']) == 0
    shown = capsys.readouterr().out
    assert 'dashboard:' in shown and 'port: 0  # --set' in shown and 'camera_sim:' in shown
    assert 'visual_servo:' not in shown
    assert bringup.main(['--config', 'sim.yaml', '--print-config']) == 0
    assert 'dashboard:' not in capsys.readouterr().out
    assert bringup.main([*words, '--set', 'dashboard.port:=70000']) == 2


def test_the_page_needs_nothing_from_elsewhere():
    for file in sorted(WEB.iterdir()):
        text = file.read_text(encoding='utf-8').replace('http://www.w3.org/2000/svg', '')
        assert 'https://' not in text and 'http://' not in text and 'innerHTML' not in text, file
        for name in re.findall(r'(?:src|href)="([^"]+)"|from \'./([^\']+)\'', text):
            assert (WEB / (name[0] or name[1])).is_file(), (file, name)


# Who may talk to it.

@pytest.mark.parametrize('host, bound, allowed', [
    ('127.0.0.1:8088', '127.0.0.1', True), ('localhost:8088', '127.0.0.1', True),
    ('localhost', '127.0.0.1', True), ('[::1]:8088', '::1', True),
    ('127.8.9.1', '127.0.0.1', True),
    ('evil.example:8088', '127.0.0.1', False), ('127.0.0.1.evil.example', '127.0.0.1', False),
    ('localhost.evil.example', '127.0.0.1', False), ('192.168.1.7:8088', '127.0.0.1', False),
    ('', '127.0.0.1', False), ('[broken', '127.0.0.1', False), ('@', '127.0.0.1', False),
    ('user@evil.example', '127.0.0.1', False), ('192.168.1.7:8088', '0.0.0.0', True),
    ('cell7.lab', 'cell7.lab', True), ('evil.example', '0.0.0.0', False)])
def test_only_names_that_cannot_be_made_to_point_here_are_let_in(host, bound, allowed):
    assert host_allowed(host, bound) is allowed


@pytest.mark.parametrize('origin, allowed', [
    (None, True), ('http://localhost:8088', True), ('http://localhost:8089', False),
    ('https://localhost:8088', False), ('http://evil.example', False), ('null', False),
    ('', False)])
def test_only_pages_of_the_same_host_are_let_in(origin, allowed):
    assert origin_allowed(origin, 'localhost:8088') is allowed


@pytest.mark.parametrize('given', [None, '', 'toke', 'tokenn', 7, ['token'], 'tökén'])
def test_nothing_but_the_token_is_the_token(given):
    assert not same_token(given, 'token')
    assert same_token('token', 'token')


# What browsers get.

@pytest.mark.parametrize('seed', range(5))
def test_readers_of_any_speed_end_with_the_same_facts_and_samples_in_order(seed):
    rng = np.random.default_rng(seed)
    board, seen, got, version, sample = Board(20), {}, [], 0, 0
    truth, count = {}, 0
    for _ in range(300):
        if rng.random() < 0.5:
            name, value = f'fact{rng.integers(4)}', int(rng.integers(3))
            board.put(name, value)
            truth[name] = value
        if rng.random() < 0.5:
            board.add([count])
            count += 1
        if rng.random() < 0.2:
            news = board.news(version, sample)
            if news is not None:
                seen.update(news.facts)
                got += [row[0] for row in news.samples]
                version, sample = news.version, news.sample
    news = board.news(version, sample)
    seen.update(news.facts if news else {})
    got += [row[0] for row in news.samples] if news else []
    assert seen == truth
    assert got == sorted(set(got)) and got[-1] == count - 1
    assert board.news(10**6, 10**6) is None


def test_the_same_again_is_no_news_and_everything_is_json():
    board = Board(5)
    board.put('progress', {'error': float('nan'), 'list': [float('inf'), 1.0]})
    news = board.news(0, 0)
    board.put('progress', {'error': float('nan'), 'list': [float('inf'), 1.0]})
    assert board.news(news.version, news.sample) is None
    assert json.loads(json.dumps(news._asdict(), allow_nan=False))['facts'] == {
        'progress': {'error': None, 'list': [None, 1.0]}}


# Messages as facts.

def path_msg(data, sizes):
    """Make a path in the image."""
    msg = Float64MultiArray(data=[float(v) for v in data])
    msg.layout.dim = [MultiArrayDimension(size=size) for size in sizes]
    return msg


@pytest.mark.parametrize('data, sizes', [
    (range(8), (2, 2)), (range(8), (1, 4, 3)), (range(7), (1, 4, 2)), (range(16), (1, 4, 2)),
    ([], (3000, 0, 2)), (range(8), ())])
def test_a_path_of_other_sizes_is_refused(data, sizes):
    assert isinstance(facts.path_fact(path_msg(data, sizes)), Rejected)


def test_a_corner_without_a_place_is_left_out():
    path = facts.path_fact(path_msg([1, 2, float('nan'), 4, 5, 6, 7, 8], (1, 4, 2)))
    assert path == [[[1.0, 2.0], None, [5.0, 6.0], [7.0, 8.0]]]


def test_a_node_shows_its_worst_part_and_other_diagnostics_do_no_harm():
    msg = DiagnosticArray(status=[
        DiagnosticStatus(name='robix_bridge: link', level=DiagnosticStatus.OK, message='fine'),
        DiagnosticStatus(name='robix_bridge: arm', level=DiagnosticStatus.ERROR, message='latched',
                         values=[KeyValue(key='age_s', value='0.1')]),
        DiagnosticStatus(name='no separator'), DiagnosticStatus(level=b'\x09', name='odd: level')])
    nodes = facts.node_facts(msg)
    assert set(nodes) == {'robix_bridge', 'odd'}
    assert (nodes['robix_bridge']['level'], nodes['robix_bridge']['message']) == (
        'error', 'latched')
    assert nodes['robix_bridge']['parts'][1]['values'] == {'age_s': '0.1'}
    assert facts.verdict_fact(DiagnosticArray()) is None


@pytest.mark.parametrize('names, positions', [(['a'], [1.0, 2.0]), (['a'], [float('nan')])])
def test_joint_states_that_make_no_sense_are_refused(names, positions):
    assert isinstance(facts.joints_fact(JointState(name=names, position=positions)), Rejected)


@pytest.mark.parametrize('width, shown', [(64, 64), (400, 200)])
def test_wide_pictures_are_made_smaller_in_proportion(width, shown):
    import cv2
    msg = image_msg(np.zeros((width // 2, width), np.uint8), Header())
    jpeg = facts.jpeg_from_image(msg, 200, 80)
    assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), 0).shape == (shown // 2, shown)


def test_a_broken_picture_is_refused():
    assert isinstance(facts.jpeg_from_image(image_msg(np.zeros((4, 4), np.uint8), Header(),
                                                      'bgr8'), 200, 80), Rejected)


# The server without ROS.

class Site:
    """A server whose buttons only count."""

    def __init__(self) -> None:
        self.board, self.pressed = Board(100), []
        self.server = DashboardServer(self.board, self.press, ['stop'], '127.0.0.1', 0)
        self.server.start()
        self.token = self.server._site.token

    async def press(self, name: str) -> Answer:
        self.pressed.append((name, time.monotonic()))
        return Answer(True, 'done')

    async def fetch(self, path: str, method: str = 'GET', **headers: str):
        """Make a request and give its answer, refused or not."""
        request = HTTPRequest(self.server.url + path, method, headers,
                              body=b'' if method == 'POST' else None)
        try:
            return await AsyncHTTPClient().fetch(request)
        except HTTPClientError as error:
            return error.response

    async def socket(self, first: object = None, **headers: str):
        """Open the live socket and say the first word."""
        url = self.server.url.replace('http', 'ws') + 'live'
        live = await websocket_connect(HTTPRequest(url, headers=headers))
        await live.write_message(json.dumps(first or {
            'token': self.token, 'watch': True, 'version': 0, 'sample': 0}))
        return live


@pytest.fixture
def site():
    made = Site()
    yield made
    made.server.stop()


@pytest.mark.parametrize('path, method', [
    ('', 'GET'), ('app.js', 'GET'), ('press/stop', 'POST'), ('live', 'GET')])
@pytest.mark.parametrize('headers', [{'Host': 'evil.example'}, {'Origin': 'http://evil.example'}])
def test_other_pages_get_nothing_and_press_nothing(site, path, method, headers):
    answer = asyncio.run(site.fetch(path, method, **headers, **{'X-Token': site.token}))
    assert answer.code == 403 and not site.pressed
    assert site.token not in answer.body.decode()


def test_buttons_need_the_token_of_this_process(site):
    async def try_all():
        for headers in ({}, {'X-Token': 'wrong'}, {'X-Token': site.token[:-1]}):
            assert (await site.fetch('press/stop', 'POST', **headers)).code == 403
        assert (await site.fetch('press/stop', 'GET', **{'X-Token': site.token})).code == 405
        assert (await site.fetch('press/other', 'POST', **{'X-Token': site.token})).code == 404
        assert not site.pressed
        answer = await site.fetch('press/stop', 'POST', **{'X-Token': site.token})
        assert json.loads(answer.body) == {'ok': True, 'message': 'done'}
        page = await site.fetch('')
        assert site.token in page.body.decode()
        assert page.headers['X-Frame-Options'] == 'DENY'
        assert "frame-ancestors 'none'" in page.headers['Content-Security-Policy']
        assert (await site.fetch('..%2fdashboard.py')).code == 404
    asyncio.run(try_all())
    assert [name for name, _ in site.pressed] == ['stop']


@pytest.mark.parametrize('first', [{'token': 'wrong'}, {'watch': True}, [1], 'text', {'token': 3}])
def test_a_socket_without_the_token_is_closed_and_told_nothing(site, first):
    site.board.put('secret', 1)

    async def listen():
        live = await site.socket(first)
        assert await live.read_message() is None
        assert live.close_code == 4001
    asyncio.run(listen())


@pytest.mark.parametrize('word', ['no json', '[[[', '{"version": "x"}', '{"version": 1}',
                                  '[' * 2000])
def test_a_socket_that_talks_nonsense_is_closed(site, word):
    async def talk():
        live = await site.socket()
        live.write_message(word)
        while await live.read_message() is not None:
            pass
    asyncio.run(talk())
    assert asyncio.run(site.fetch('')).code == 200


def test_too_many_browsers_are_turned_away_and_may_come_later(site):
    async def crowd():
        inside = [await site.socket() for _ in range(BROWSERS)]
        late = await site.socket()
        while await late.read_message() is not None:
            pass
        assert late.close_code == 4002
        inside[0].close()
        while site.server.browsers >= BROWSERS:
            await asyncio.sleep(0.01)
        again = await site.socket()
        site.board.put('fact', 1)
        assert await again.read_message() is not None
    asyncio.run(crowd())


def stuck_browser(site) -> socket.socket:
    """Connect as a browser does, say the token, and never read a byte."""
    raw = socket.create_connection(('127.0.0.1', site.server.port))
    raw.sendall(b'GET /live HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n'
                b'Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n'
                b'Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n')
    while b'\r\n\r\n' not in raw.recv(4096):
        pass
    words = json.dumps({'token': site.token, 'watch': True, 'version': 0, 'sample': 0}).encode()
    mask = b'\0\0\0\0'
    raw.sendall(bytes([0x81, 0x80 | len(words)]) + mask + words)
    return raw


def test_browsers_that_never_read_slow_nobody_and_cost_one_picture(site):
    crowd = [stuck_browser(site) for _ in range(BROWSERS - 1)]
    picture = bytes(100_000)

    async def watch():
        live = await site.socket()
        while site.server.watching < BROWSERS:
            await asyncio.sleep(0.01)
        feed = PeriodicCallback(lambda: site.server.show_frame(picture), 20.0)
        feed.start()
        for _ in range(60):
            assert await live.read_message() == picture
            await live.write_message('{"frame": true}')
        feed.stop()
        began_s = time.monotonic()
        await site.fetch('press/stop', 'POST', **{'X-Token': site.token})
        return site.pressed[0][1] - began_s

    delay_s = asyncio.run(asyncio.wait_for(watch(), 30.0))
    assert delay_s < 0.15
    waiting = [len(browser.ws_connection.stream._write_buffer)
               for browser in site.server._site.browsers]
    assert sum(waiting) <= BROWSERS * 1.1 * len(picture)
    for raw in crowd:
        raw.close()
