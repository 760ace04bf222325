"""What the documentation tells a user to type, typed."""

import re
import shlex
import shutil

import pytest

from pendubot_identification.cli.main import main
from test.conftest import RECORDINGS, ROOT

PAGES = [ROOT / 'README.md', ROOT / 'bags' / 'README.md', *sorted((ROOT / 'docs').glob('*.md'))]


def commands(page):
    """The offline pendubot commands in a page's code blocks; those that need a rig or half a minute are left out."""
    lines = re.findall(
        r'^(?:    )?\$? ?(pendubot (?:identify|report|compare|simulate|info|import-csv) [^#\n]*)',
        page.read_text(),
        re.MULTILINE,
    )
    return [line.strip() for line in lines if 'BAG' not in line and 'FILE' not in line]


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_work_as_printed(page, tmp_path, monkeypatch, capsys):
    """In an empty folder with the sample bag and, under the names that the pages use, recordings of one's own."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / 'bags', tmp_path / 'bags')
    assert main(['simulate', '--output', 'swing']) == 0
    rows = ['t,shoulder,elbow,torque', *(f'{k * 0.01},{90 + k % 7},{k % 5},{0.1 * (k % 3)}' for k in range(300))]
    (tmp_path / 'matlab.csv').write_text('\n'.join(rows))
    for command in commands(page):
        assert main(shlex.split(command)[1:]) == 0, f'{page.name}: {command}\n{capsys.readouterr().err}'


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    for target in re.findall(r'\]\(([^)#]+)', page.read_text()):
        if not target.startswith('http'):
            assert (page.parent / target).exists(), f'{page.name} links to {target}'


@pytest.mark.recordings
def test_no_real_recording_is_copied_into_the_repository():
    sizes = {path.stat().st_size for path in RECORDINGS.glob('*.csv')}
    ours = [path for path in ROOT.rglob('*.csv') if '.venv' not in path.parts]
    assert not [path for path in ours if path.stat().st_size in sizes]
