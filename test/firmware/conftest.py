# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The board in C and the board in QEMU."""

import pytest

from test.conftest import ROOT

from .building import FIRMWARE, compiled
from .emulator import Emulator
from .link_probe import LinkProbe


@pytest.fixture(scope='session')
def probe(tmp_path_factory):
    program = tmp_path_factory.mktemp('probe') / 'link_probe'
    probe = LinkProbe(compiled(program, ROOT / 'test/firmware/link_probe.c', FIRMWARE / 'pendubot_link.c'))
    yield probe
    probe.close()


@pytest.fixture
def emulator(tmp_path):
    with Emulator(tmp_path) as emulator:
        yield emulator
