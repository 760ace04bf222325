# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The linters of a ROS release, if installed, with the settings of this project."""

import shutil

import pytest

from test.conftest import ROOT

PLACES = [str(ROOT / part) for part in ('docs', 'launch', 'pendubot_identification', 'setup.py')]
#: Rules that Google's style or the convention "ament" ignores.
PEP257 = [f'D{number}' for number in (*range(100, 108), 203, 205, 212, 213, 400, 401, 403, 404, 406, 407, 413, 415)]
HEADER = '{copyright}\nSPDX-License-Identifier: Apache-2.0\n'


@pytest.mark.parametrize(
    ('linter', 'arguments'),
    [
        ('flake8', ['--config', str(ROOT / 'setup.cfg'), *PLACES]),
        ('pep257', ['--ignore', *PEP257, '--', *PLACES]),
        ('copyright', [str(ROOT / 'firmware'), str(ROOT / 'LICENSE'), *PLACES]),
        ('xmllint', [str(ROOT / part) for part in ('config', 'test')]),
    ],
)
def test_a_linter_of_ros_finds_nothing(monkeypatch, linter, arguments):
    main = pytest.importorskip(f'ament_{linter}.main').main
    if linter == 'xmllint' and shutil.which('xmllint') is None:
        pytest.skip('xmllint is not installed')
    if linter == 'copyright':  # it expects whole headers; this project has the short form of SPDX
        from ament_copyright import licenses, parser

        short = licenses.apache2._replace(file_headers=[HEADER])
        monkeypatch.setattr(parser, 'get_licenses', lambda: {'apache2': short})
    assert main(argv=arguments) == 0
