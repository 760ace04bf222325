# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The studio in its own process, and a page's requests without a browser."""

import json
from http.client import HTTPConnection
from urllib.parse import quote, urlsplit

import pytest

from test.processes import Program

pytest.importorskip('aiohttp')


class Studio(Program):
    """The program and its address."""

    def __init__(self, *files, program=('pendubot', 'studio', '--no-browser'), **how):
        super().__init__(*program, *files, **how)
        self.address = self.wait_for('studio: ').split()[1]
        self.port, self.root = urlsplit(self.address).port, urlsplit(self.address).path

    def request(self, method, path, body=None, headers=None, root=None, host='127.0.0.1'):
        connection = HTTPConnection(host, self.port, timeout=120)
        connection.request(method, (self.root if root is None else root) + path, body, headers or {})
        return connection.getresponse()

    def open(self):
        return Page(self)


class Page:
    """A session like a page's."""

    def __init__(self, studio):
        self.studio = studio
        self.about = json.loads(studio.request('POST', 'sessions').read())
        self.path = f'sessions/{self.about["session"]}/'

    def give(self, name, content):
        answer = self.studio.request('PUT', f'{self.path}files/{quote(name)}', content)
        return answer.status, answer.read().decode()

    def post(self, task, *names, validate=(), windows=None, **options):
        """Start a task; return the response, whose lines are its events."""
        bags, validation = ([{'name': name, **(windows or {})} for name in part] for part in (names, validate))
        body = json.dumps({'bags': bags, 'validate': validation, 'options': options})
        return self.studio.request('POST', self.path + task, body)

    def do(self, task, *names, **how):
        """Return the last event of a task."""
        return json.loads(self.post(task, *names, **how).read().splitlines()[-1])

    def output(self, name):
        answer = self.studio.request('GET', f'{self.path}output/{name}')
        return answer.read().decode() if answer.status == 200 else None
