"""
The dashboard's web server: one page, one socket per browser, one address per button.

Runs in a thread of its own and knows nothing of ROS. Every browser has at most one
picture and one update on the way: the next goes out when it has confirmed the last,
so a browser that sleeps or hangs costs a few kilobytes and no time.
"""

from __future__ import annotations

import asyncio
import json
import logging
from pathlib import Path
import threading
import time
from typing import Any, Awaitable, Callable, NamedTuple

from homography_servo.nodes.dashboard_board import Board
from homography_servo.nodes.dashboard_guard import host_allowed
from homography_servo.nodes.dashboard_guard import new_token
from homography_servo.nodes.dashboard_guard import origin_allowed
from homography_servo.nodes.dashboard_guard import same_token
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.ioloop import PeriodicCallback
from tornado.netutil import bind_sockets
from tornado.web import Application
from tornado.web import RequestHandler
from tornado.web import StaticFileHandler
from tornado.websocket import WebSocketClosedError
from tornado.websocket import WebSocketHandler

WEB = Path(__file__).with_name('web')
UPDATE_PERIOD_S = 0.1
BROWSERS = 32
CONFIRM_S = 20.0  # a browser that confirms nothing for so long is let go; it can come back
BAD_TOKEN, TOO_MANY, SILENT = 4001, 4002, 4003
HEADERS = {
    'Content-Security-Policy': "default-src 'self'; img-src 'self' blob: data:; "
                               "frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    'X-Frame-Options': 'DENY',
    'X-Content-Type-Options': 'nosniff',
    'Referrer-Policy': 'no-referrer',
    'Cross-Origin-Resource-Policy': 'same-origin',
    'Cache-Control': 'no-store',
}


class Answer(NamedTuple):
    """How a button's work went, in a sentence."""

    ok: bool
    message: str


Press = Callable[[str], Awaitable[Answer]]


class Site(NamedTuple):
    """What the handlers work with."""

    board: Board
    press: Press
    actions: frozenset
    host: str
    token: str
    browsers: set


class Guarded:
    """Refuses what does not come from the dashboard's own page."""

    def initialize(self, site: Site, **kwargs: Any) -> None:
        """Take the site; the rest goes to the handler."""
        self.site = site
        if kwargs:
            super().initialize(**kwargs)

    def set_default_headers(self) -> None:
        """Keep the page out of other pages and out of caches."""
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        """Check where the request goes to and comes from."""
        headers = self.request.headers
        host = headers.get('Host', '')
        if not host_allowed(host, self.site.host):
            self._refuse(f'the dashboard is not called {host!r}')
        elif not origin_allowed(headers.get('Origin'), host):
            self._refuse('this request comes from another page')

    def _refuse(self, reason: str) -> None:
        self.set_status(403)
        self.finish({'ok': False, 'message': reason})


class PageHandler(Guarded, RequestHandler):
    """The page, with the token inside."""

    def get(self) -> None:
        """Give the page."""
        page = (WEB / 'index.html').read_text(encoding='utf-8')
        self.finish(page.replace('@TOKEN@', self.site.token))


class FileHandler(Guarded, StaticFileHandler):
    """Scripts and style of the page."""

    def set_extra_headers(self, path: str) -> None:
        """Never let the browser keep files of an older version."""
        self.set_header('Cache-Control', 'no-store')


class ButtonHandler(Guarded, RequestHandler):
    """One button pressed."""

    async def post(self, name: str) -> None:
        """Do what the button says and answer with a sentence."""
        if not same_token(self.request.headers.get('X-Token'), self.site.token):
            self._refuse('the page is from an earlier run; reload it')
            return
        if name not in self.site.actions:
            self.set_status(404)
            self.finish({'ok': False, 'message': f'no button {name!r}'})
            return
        answer = await self.site.press(name)
        self.finish({'ok': answer.ok, 'message': answer.message})


class LiveHandler(Guarded, WebSocketHandler):
    """The socket of one browser; sends nothing before the token has come."""

    admitted = False
    watching = False
    update_sent_s = 0.0  # 0: confirmed
    frame_sent_s = 0.0
    version = sample = 0

    def check_origin(self, origin: str) -> bool:
        """Demand the dashboard's own page."""
        return origin_allowed(origin, self.request.headers.get('Host', ''))

    def open(self) -> None:
        """Count the browser, and let it go where there are too many."""
        self.set_nodelay(True)
        self.opened_s = time.monotonic()
        if len(self.site.browsers) >= BROWSERS:
            self.close(TOO_MANY, 'too many browsers are watching')
            return
        self.site.browsers.add(self)

    def on_close(self) -> None:
        """Forget the browser."""
        self.site.browsers.discard(self)

    def on_message(self, message: str | bytes) -> None:
        """Take the token, a confirmation, or whether the page can be seen."""
        try:
            words = json.loads(message)
            self._take(words if isinstance(words, dict) else {})
        except (ValueError, TypeError, RecursionError):
            self.close(BAD_TOKEN, 'not understood')

    def _take(self, words: dict) -> None:
        if not self.admitted:
            self.admitted = same_token(words.get('token'), self.site.token)
            if not self.admitted:
                self.close(BAD_TOKEN, 'the page is from an earlier run')
                return
        self.watching = bool(words.get('watch', self.watching))
        if 'version' in words:
            self.version, self.sample = int(words['version']), int(words['sample'])
            self.update_sent_s = 0.0
        if 'frame' in words:
            self.frame_sent_s = 0.0

    def silent(self, now_s: float) -> bool:
        """Tell whether the browser owes a word for too long."""
        since_s = [s for s in (self.update_sent_s, self.frame_sent_s) if s]
        if not self.admitted:
            since_s.append(self.opened_s)
        return any(now_s - s > CONFIRM_S for s in since_s)

    def send_update(self) -> None:
        """Send what the browser does not have yet, unless it is still busy."""
        if not self.admitted or self.update_sent_s:
            return
        news = self.site.board.news(self.version, self.sample)
        if news is not None:
            self.update_sent_s = time.monotonic()
            self._send(json.dumps(news._asdict(), allow_nan=False))

    def send_frame(self, jpeg: bytes) -> None:
        """Send a picture, unless the browser is still busy with the last."""
        if self.admitted and self.watching and not self.frame_sent_s:
            self.frame_sent_s = time.monotonic()
            self._send(jpeg)

    def _send(self, data: str | bytes) -> None:
        try:
            sent = self.write_message(data, binary=isinstance(data, bytes))
            sent.add_done_callback(lambda future: future.exception())  # closed meanwhile
        except WebSocketClosedError:
            self.site.browsers.discard(self)


class DashboardServer:
    """
    The server with its thread; binds at once, so that a taken port is told early.

    Parameters
    ----------
    board : Board
        What is shown.
    press : coroutine function
        Does the work of a button, in the server's thread, and gives an `Answer`.
    actions : iterable of str
        The buttons there are.
    host, port
        Where to listen; port 0 takes any free one.

    Raises
    ------
    OSError
        When the address cannot be listened on.

    """

    def __init__(self, board: Board, press: Press, actions, host: str, port: int) -> None:
        self._sockets = bind_sockets(port, host)
        self.port = self._sockets[0].getsockname()[1]
        self.url = f'http://{f"[{host}]" if ":" in host else host}:{self.port}/'
        self.loop: asyncio.AbstractEventLoop = asyncio.new_event_loop()
        self._site = Site(board, press, frozenset(actions), host, new_token(), set())
        self._watching = 0
        self._thread = threading.Thread(target=self._run, name='dashboard', daemon=True)

    @property
    def watching(self) -> int:
        """Give how many browsers want pictures now."""
        return self._watching

    @property
    def browsers(self) -> int:
        """Give how many browsers are connected."""
        return len(self._site.browsers)

    def start(self) -> None:
        """Begin to serve."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close everything."""
        if self._thread.is_alive():
            self.loop.call_soon_threadsafe(self.loop.stop)
            self._thread.join(1.0)

    def show_frame(self, jpeg: bytes) -> None:
        """Offer a picture to every browser; may be called from any thread."""
        self.loop.call_soon_threadsafe(self._send_frame, jpeg)

    def _run(self) -> None:
        asyncio.set_event_loop(self.loop)
        # Refusals are answered; the log of the node is not theirs to fill.
        logging.getLogger('tornado').setLevel(logging.ERROR)
        server = HTTPServer(self._application(), max_body_size=4096, max_header_size=16384,
                            idle_connection_timeout=60.0, body_timeout=10.0)
        server.add_sockets(self._sockets)
        beat = PeriodicCallback(self._beat, 1000.0 * UPDATE_PERIOD_S)
        beat.start()
        self.loop.run_forever()
        beat.stop()
        server.stop()
        IOLoop.current().close(all_fds=True)

    def _application(self) -> Application:
        site = {'site': self._site}
        return Application([
            (r'/', PageHandler, site),
            (r'/live', LiveHandler, site),
            (r'/press/([a-z_]{1,40})', ButtonHandler, site),
            (r'/(\w+\.(?:js|css|svg))', FileHandler, {**site, 'path': str(WEB)}),
        ], log_function=lambda handler: None, websocket_max_message_size=4096,
            websocket_ping_interval=10.0, compress_response=False)

    def _beat(self) -> None:
        now_s = time.monotonic()
        for browser in list(self._site.browsers):
            if browser.silent(now_s):
                browser.close(SILENT, 'no word for too long')
                self._site.browsers.discard(browser)
            else:
                browser.send_update()
        self._watching = sum(b.admitted and b.watching for b in self._site.browsers)

    def _send_frame(self, jpeg: bytes) -> None:
        for browser in list(self._site.browsers):
            browser.send_frame(jpeg)
