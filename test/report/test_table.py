# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""One table, shown as text and as Markdown; the page shows it in test_page."""

from pendubot_identification.report.table import Number, Table

TABLE = Table(
    ['', 'left | right', ('after ', Number(0.25, 'g', 'prediction.horizons.1'), ' s')],
    [['P1', Number(0.0022073, '.4f', 'a'), '-'], ['friction', Number(None, '.3f', 'b'), (Number(1, '', 'c'), ' ± 2')]],
    [('a note of ', Number(0.5, '.0%', 'd')), ' '.join(['words'] * 30)],
)


def test_text_is_aligned_and_notes_are_wrapped():
    *rows, note, words, more = TABLE.text().splitlines()
    assert rows == [
        '          left | right  after 0.25 s',
        'P1              0.0022             -',
        'friction             -         1 ± 2',
    ]
    assert note == 'a note of 50%'
    assert max(len(words), len(more)) <= 120
    assert f'{words} {more.strip()}' == ' '.join(['words'] * 30)


def test_markdown_of_a_table_and_its_notes():
    table, note, words = TABLE.markdown().rstrip('\n').split('\n\n')
    assert table.splitlines() == [
        r'|  | left \| right | after 0.25 s |',
        '| --- | ---: | ---: |',
        '| P1 | 0.0022 | - |',
        '| friction | - | 1 ± 2 |',
    ]
    assert (note, words) == ('a note of 50%', ' '.join(['words'] * 30))
