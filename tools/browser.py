"""
A headless Chromium, driven through its DevTools protocol; for tests and screenshots.

Needs a Chromium or Chrome on the machine (Debian: ``apt install chromium``) and
tornado, which the dashboard needs anyway.
"""

from __future__ import annotations

import asyncio
import base64
from concurrent.futures import Future
import itertools
import json
from pathlib import Path
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from typing import Any, Callable
from urllib.request import urlopen

from tornado.websocket import websocket_connect

NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'chrome')
FLAGS = ('--headless=new', '--no-sandbox', '--disable-gpu', '--disable-background-networking',
         '--disable-component-update', '--disable-sync', '--no-first-run', '--hide-scrollbars',
         '--disable-dev-shm-usage', '--remote-debugging-port=0')
PATIENCE_S = 30.0


def find_browser() -> str | None:
    """Give the path of a Chromium, None where there is none."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class BrowserError(Exception):
    """The browser, or the page's script, reported an error."""


class Browser:
    """
    One browser with one page.

    ``errors`` collects what the page's scripts and the browser complain about.
    """

    def __init__(self, width: int = 1280, height: int = 900) -> None:
        self.errors: list[str] = []
        self._folder = tempfile.mkdtemp(prefix='browser_')
        self._process = subprocess.Popen(
            [find_browser(), *FLAGS, f'--user-data-dir={self._folder}', 'about:blank'],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            start_new_session=True)
        self._numbers, self._waiting = itertools.count(1), {}
        self._loop = asyncio.new_event_loop()
        threading.Thread(target=self._loop.run_forever, daemon=True).start()
        try:
            self._connect()
            for domain in ('Page', 'Runtime', 'Log'):
                self.command(f'{domain}.enable')
            self.resize(width, height)
        except BaseException:
            self.close()
            raise

    def _connect(self) -> None:
        pages = [page for page in json.load(urlopen(f'http://127.0.0.1:{self._port()}/json'))
                 if page['type'] == 'page']
        url = pages[0]['webSocketDebuggerUrl']
        self._socket = asyncio.run_coroutine_threadsafe(
            _socket(url, self._on_message), self._loop).result(PATIENCE_S)

    def _port(self) -> int:
        file = Path(self._folder) / 'DevToolsActivePort'
        until_s = time.monotonic() + PATIENCE_S
        while not (file.exists() and file.read_text().count('\n')):
            if self._process.poll() is not None or time.monotonic() > until_s:
                raise BrowserError('the browser did not start')
            time.sleep(0.02)
        return int(file.read_text().split()[0])

    def _on_message(self, text: str | None) -> None:
        message = json.loads(text) if text else {}
        if 'id' in message:
            self._waiting.pop(message['id']).set_result(message)
        elif message.get('method') == 'Runtime.exceptionThrown':
            details = message['params']['exceptionDetails']
            self.errors.append(details.get('exception', {}).get('description', details['text']))
        elif message.get('method') == 'Log.entryAdded':
            entry = message['params']['entry']
            if entry['level'] == 'error':
                self.errors.append(f'{entry["text"]} {entry.get("url", "")}')

    def command(self, method: str, **parameters: Any) -> dict:
        """Send a command of the protocol and give its result."""
        number, future = next(self._numbers), Future()
        self._waiting[number] = future
        text = json.dumps({'id': number, 'method': method, 'params': parameters})
        self._loop.call_soon_threadsafe(self._socket.write_message, text)
        answer = future.result(PATIENCE_S)
        if 'error' in answer:
            raise BrowserError(f'{method}: {answer["error"]["message"]}')
        return answer['result']

    def open(self, url: str) -> None:
        """Go to a page and wait until it is there."""
        self.command('Page.navigate', url=url)
        until_s = time.monotonic() + PATIENCE_S
        while self.run('location.href + document.readyState') != f'{url}complete':
            if time.monotonic() > until_s:
                raise BrowserError(f'{url} did not load')
            time.sleep(0.02)

    def run(self, script: str) -> Any:
        """Evaluate a script in the page, awaiting promises, and give its value."""
        try:
            answer = self.command('Runtime.evaluate', expression=script, awaitPromise=True,
                                  returnByValue=True)
        except BrowserError:  # the page was just being replaced; a second refusal is meant
            answer = self.command('Runtime.evaluate', expression=script, awaitPromise=True,
                                  returnByValue=True)
        if 'exceptionDetails' in answer:
            details = answer['exceptionDetails']
            raise BrowserError(details.get('exception', {}).get('description', details['text']))
        return answer['result'].get('value')

    def text(self, selector: str) -> str:
        """Give the text that a person reads at an element, empty where there is none."""
        return self.run(f'(document.querySelector({json.dumps(selector)}) || "").innerText') or ''

    def click(self, selector: str) -> None:
        """Press and release the mouse in the middle of an element."""
        place = self.run(
            f'(() => {{ const e = document.querySelector({json.dumps(selector)});'
            ' e.scrollIntoView({block: "nearest"}); const r = e.getBoundingClientRect();'
            ' return [r.x + r.width / 2, r.y + r.height / 2]; })()')
        for kind in ('mousePressed', 'mouseReleased'):
            self.command('Input.dispatchMouseEvent', type=kind, x=place[0], y=place[1],
                         button='left', clickCount=1)

    def resize(self, width: int, height: int, mobile: bool = False, scale: float = 1.0) -> None:
        """Give the page a size [px]."""
        self.command('Emulation.setDeviceMetricsOverride', width=width, height=height,
                     deviceScaleFactor=scale, mobile=mobile)

    def screenshot(self, path: str | Path, whole: bool = True) -> None:
        """Save what the page looks like as PNG, all of it or only what is in the window."""
        shot = self.command('Page.captureScreenshot', format='png', captureBeyondViewport=whole)
        Path(path).write_bytes(base64.b64decode(shot['data']))

    def close(self) -> None:
        """End the browser and remove its traces."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(5.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._loop.call_soon_threadsafe(self._loop.stop)
        shutil.rmtree(self._folder, ignore_errors=True)


async def _socket(url: str, on_message: Callable) -> Any:
    return await websocket_connect(url, on_message_callback=on_message,
                                   max_message_size=1 << 27)
