# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The server of the studio, for browsers on this computer that have its token.

A session is a private folder for the files that a page receives; it is deleted with the page or with the server.
"""

import asyncio
import json
import os
import re
import secrets
import shutil
import signal
import socket
import sys
import tempfile
import webbrowser
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from aiohttp import web

from pendubot_identification.errors import MissingFileError, PendubotError, UsageError
from pendubot_identification.identification import APPLY_REMEDIES, EXPERT_OPTIONS, OPTIONS, START
from pendubot_identification.resources import resource
from pendubot_identification.setting import Setting
from pendubot_identification.trajectories.conventions import CONVERSION

ROOMS = Path(__file__).parent.parent
#: The files of the page by address; base.css also gives the report's pages their colours and controls.
PAGE = {name: ROOMS / 'studio' / (name or 'studio.html') for name in ('', 'studio.css', 'studio.js')}
PAGE |= {'base.css': ROOMS / 'report' / 'base.css'}
#: The name of a received file, which may be in a bag's folder: not hidden, no option, no path.
NAME = re.compile(r'[^/\\.-][^/\\]{0,198}(/[^/\\.-][^/\\]{0,198})?')
#: Longest line of a task [bytes].
LINE = 1 << 24
BOUNDS = Setting('bounds', '', 'search intervals, such as P1=0:0.5, or fixed values, such as b2=0', optional=True)
#: The options of the page, without expert settings.
SETTINGS = {s.name: s for s in (*OPTIONS, BOUNDS, APPLY_REMEDIES, *CONVERSION) if s not in EXPERT_OPTIONS}
NO_SPACE = 'free space on this disk, or start the studio with TMPDIR on another one'
#: Pages load nothing from a network. The page of a result may run its own scripts, but not call the studio.
POLICY = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src data:; frame-src 'self'"
OUTPUT_POLICY = (
    "sandbox allow-scripts allow-downloads allow-modals; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:"
)
HEADERS = {'X-Content-Type-Options': 'nosniff', 'Referrer-Policy': 'no-referrer', 'Cache-Control': 'no-store'}
HEADERS |= {'Content-Security-Policy': POLICY}


@dataclass
class Session:
    """The files of one page."""

    folder: Path  #: private folder, with received files in ``files`` and the files of the result in ``output``.
    #: paths of recordings by name, absolute if given in the terminal, else relative to ``files``.
    recordings: dict[str, str]

    def place(self, name: str) -> Path:
        """Return the path for a received file. Raises PendubotError: the name is invalid."""
        if not NAME.fullmatch(name) or not name.isprintable():
            raise PendubotError(f'{name!r} is no name of a recording; rename the file without a leading dot or hyphen')
        return self.folder / 'files' / name


class Studio:
    """The sessions, and the workers for their tasks."""

    def __init__(self, given: dict[str, str], port: int, *, debug: bool) -> None:
        self.token = secrets.token_urlsafe(24)
        self._hosts = f'127.0.0.1:{port}', f'localhost:{port}'
        self._given, self._debug = given, debug
        self._sessions: dict[str, Session] = {}
        self._spare: asyncio.Task[asyncio.subprocess.Process] | None = None
        self._root = Path(tempfile.mkdtemp(prefix='pendubot-studio-'))

    def application(self) -> web.Application:
        """Return the application with all routes below the token."""
        app = web.Application(middlewares=[self._guard])
        app.on_response_prepare.append(_add_headers)
        app.on_cleanup.append(self._close)
        at = f'/{self.token}'
        session = f'{at}/sessions/{{session}}'
        app.add_routes(
            [
                *(web.get(f'{at}/{name}', self._static) for name in PAGE),
                web.post(f'{at}/sessions', self._open),
                web.post(f'{session}/end', self._end),
                web.put(f'{session}/files/{{name:.+}}', self._receive),
                web.post(f'{session}/{{task:describe|check|identify}}', self._do),
                web.get(f'{session}/output/{{name}}', self._output),
            ]
        )
        return app

    async def _close(self, _: web.Application) -> None:
        if self._spare is not None:
            await _ended(await self._spare)
        shutil.rmtree(self._root, ignore_errors=True)

    @web.middleware
    async def _guard(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        """Refuse other host names (DNS rebinding) and requests without the token; send errors as sentences."""
        token = request.path.split('/')[1]
        if request.host not in self._hosts or not secrets.compare_digest(token.encode(), self.token.encode()):
            return web.Response(status=403, text='this address has no token of the studio; copy it from the terminal')
        try:
            return await handler(request)
        except PendubotError as error:
            return web.Response(status=400, text=str(error))
        except OSError as error:
            text = f'the file cannot be stored ({error.strerror}); rename it, or {NO_SPACE}'
            return web.Response(status=507, text=text)

    async def _static(self, request: web.Request) -> web.StreamResponse:
        return web.FileResponse(PAGE[request.path.rpartition('/')[2]])

    async def _open(self, _: web.Request) -> web.Response:
        """Open a session; answer with its name, the recordings, and the options."""
        name = secrets.token_urlsafe(12)
        recordings = {'paper_experiment': str(resource('bags/paper_experiment'))} | self._given
        self._sessions[name] = Session(self._root / name, recordings)
        (self._root / name / 'files').mkdir(parents=True)
        about = {name: _described(setting) for name, setting in SETTINGS.items()}
        return web.json_response({'session': name, 'given': list(self._given), 'settings': about})

    async def _end(self, request: web.Request) -> web.Response:
        session = self._sessions.pop(request.match_info['session'], None)
        if session is not None:
            await asyncio.to_thread(shutil.rmtree, session.folder, ignore_errors=True)
        return web.Response()

    def _session(self, request: web.Request) -> Session:
        if (session := self._sessions.get(request.match_info['session'])) is None:
            raise PendubotError('this page is closed already; load it again')
        return session

    async def _receive(self, request: web.Request) -> web.Response:
        """Receive a file, complete or not at all."""
        session, name = self._session(request), request.match_info['name']
        place, recording = session.place(name), name.partition('/')[0]
        if recording in self._given:
            raise PendubotError(f'a recording {recording} was given in the terminal; rename one of the two')
        place.parent.mkdir(exist_ok=True)
        partial = place.with_name(f'.{secrets.token_hex(8)}')
        try:
            with partial.open('wb') as file:
                async for block in request.content.iter_chunked(1 << 20):
                    file.write(block)
            partial.replace(place)
        finally:
            partial.unlink(missing_ok=True)
        session.recordings[recording] = recording
        return web.json_response({'name': recording})

    async def _do(self, request: web.Request) -> web.StreamResponse:
        """Run a task in a separate process."""
        session = self._session(request)
        task = {'task': request.match_info['task'], 'folder': str(session.folder), 'no_space': NO_SPACE}
        try:
            job = _job(session, await request.json()) | task
        except (ValueError, TypeError, AttributeError, KeyError) as error:
            raise PendubotError('the request lacks bags, validate or options; load the page again') from error
        worker = self._spare or self.prepare()
        self.prepare()
        process = await worker
        assert process.stdin is not None
        process.stdin.write(json.dumps(job).encode() + b'\n')
        return await _relay(request, process)

    def prepare(self) -> asyncio.Task[asyncio.subprocess.Process]:
        """Start the worker of the next task before it is needed, because its imports take a second."""
        self._spare = asyncio.create_task(self._started())
        return self._spare

    async def _started(self) -> asyncio.subprocess.Process:
        quiet = None if self._debug else asyncio.subprocess.DEVNULL
        pipe = asyncio.subprocess.PIPE
        env = {**os.environ, 'OPENBLAS_NUM_THREADS': '1'}
        words = sys.executable, '-m', 'pendubot_identification.studio.worker'
        return await asyncio.create_subprocess_exec(*words, stdin=pipe, stdout=pipe, stderr=quiet, limit=LINE, env=env)

    async def _output(self, request: web.Request) -> web.StreamResponse:
        """Send a file of a result."""
        folder = self._session(request).folder / 'output'
        name = request.match_info['name']
        if not folder.is_dir() or name not in os.listdir(folder):
            raise PendubotError(f'there is no file {name}; identify first')
        return web.FileResponse(folder / name, headers={'Content-Security-Policy': OUTPUT_POLICY})


async def _add_headers(_: web.Request, response: web.StreamResponse) -> None:
    for name, value in HEADERS.items():
        response.headers.setdefault(name, value)


async def _relay(request: web.Request, process: asyncio.subprocess.Process) -> web.StreamResponse:
    """Send each line of a worker at once, and end the worker with the request; report a missing last line."""
    response = web.StreamResponse(headers={'Content-Type': 'application/x-ndjson'})
    line = b''
    assert process.stdout is not None
    try:
        await response.prepare(request)
        async for line in process.stdout:
            await response.write(line)
        status = await process.wait()
    finally:
        await _ended(process)
    if not line.startswith((b'{"done"', b'{"problem"')):
        end = f'signal {-status}, perhaps for lack of memory' if status < 0 else f'status {status}'
        sentence = f'the program of this task ended with {end}; give a shorter recording or see pendubot studio --debug'
        await response.write(json.dumps({'problem': {'sentence': sentence}}).encode() + b'\n')
    return response


async def _ended(process: asyncio.subprocess.Process) -> None:
    with suppress(ProcessLookupError):
        process.kill()
    await asyncio.shield(process.wait())


def _described(setting: Setting) -> dict[str, Any]:
    default = setting.default if not isinstance(setting.default, tuple) else ':'.join(map(str, setting.default))
    kind = type(setting.default).__name__
    about = {'default': default, 'kind': kind, 'choices': setting.choices, 'help': setting.help()}
    return {**about, 'optional': setting.optional, 'reading': setting in CONVERSION}


def _job(session: Session, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Return the job of a request, with the paths of recordings.

    Raises:
        PendubotError: a recording or an option is unknown.
    """

    def window(given: Mapping[str, Any]) -> str:
        name, start, end = (str(given.get(key) or '') for key in ('name', 'start', 'end'))
        if name not in session.recordings:
            raise PendubotError(f'there is no recording {name}; give it again')
        return session.recordings[name] + (f'@{start}:{end}' if start or end else '')

    bags, validate = ([window(each) for each in asked[key]] for key in ('bags', 'validate'))
    if unknown := asked['options'].keys() - SETTINGS.keys():
        raise PendubotError(f'there is no option {min(unknown)!r} in the studio; use the command line')
    options = dict(asked['options'])
    if START.name in options:
        options[START.name] = window({'name': options[START.name]})
    return {**asked, 'bags': bags, 'validate': validate, 'options': options}


def given_recordings(texts: Sequence[str]) -> dict[str, str]:
    """Return the absolute paths of recordings by name.

    Raises:
        PendubotError: a recording is missing, or two have the same name.
    """
    found: dict[str, str] = {}
    for text in texts:
        path = Path(text).absolute()
        if not path.exists():
            raise MissingFileError(f'there is no recording {text}; check its name and folder')
        if found.setdefault(path.name, str(path)) != str(path):
            raise UsageError(f'two recordings have the name {path.name}; rename one of them')
    return found


def serve(files: Sequence[str], port: int, *, browser: bool, debug: bool) -> None:
    """Serve the studio on 127.0.0.1 until a signal.

    Raises:
        PendubotError: a recording is missing, or the port is taken.
    """
    given = given_recordings(files)
    try:
        sock = socket.create_server(('127.0.0.1', port))
    except (OSError, OverflowError) as error:
        reason = getattr(error, 'strerror', error)
        raise PendubotError(f'port {port} cannot be opened ({reason}); leave out --port') from error
    studio = Studio(given, sock.getsockname()[1], debug=debug)

    ended = False

    def end() -> None:
        nonlocal ended
        if not ended:  # a second signal must not interrupt the deletion of the files
            ended = True
            raise web.GracefulExit

    async def announce(_: web.Application) -> None:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            asyncio.get_running_loop().add_signal_handler(number, end)
        studio.prepare()
        address = f'http://127.0.0.1:{sock.getsockname()[1]}/{studio.token}/'
        print(f'studio: {address}\nCtrl-C ends it and deletes its files', flush=True)
        if browser:
            await asyncio.to_thread(webbrowser.open, address)

    application = studio.application()
    application.on_startup.append(announce)
    how: dict[str, Any] = {'print': None, 'access_log': None, 'handler_cancellation': True, 'shutdown_timeout': 1.0}
    web.run_app(application, sock=sock, **how)
