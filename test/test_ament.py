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


def test_flake8():
    pytest.importorskip('ament_flake8')
    from ament_flake8.main import main_with_errors as main

    status, errors = main(argv=['--config', str(ROOT / 'setup.cfg'), *PLACES])
    assert status == 0, '\n'.join(errors)


def test_pep257():
    pytest.importorskip('ament_pep257')
    from ament_pep257.main import main

    assert main(argv=['--ignore', *PEP257, '--', *PLACES]) == 0


def test_copyright(monkeypatch):
    """The linter expects whole headers; this project has the short form of SPDX."""
    pytest.importorskip('ament_copyright')
    from ament_copyright import licenses, parser
    from ament_copyright.main import main

    short = licenses.apache2._replace(file_headers=[HEADER])
    monkeypatch.setattr(parser, 'get_licenses', lambda: {'apache2': short})
    assert main(argv=[str(ROOT / 'firmware'), str(ROOT / 'LICENSE'), *PLACES]) == 0


def test_xmllint():
    pytest.importorskip('ament_xmllint')
    from ament_xmllint.main import main

    if shutil.which('xmllint') is None:
        pytest.skip('xmllint is not installed')
    assert main(argv=[str(ROOT / part) for part in ('config', 'test')]) == 0
