# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Tables in Markdown."""


def table(names, rows):
    """Print a table: the names of its columns, then each row as soon as it is measured."""
    print(f'\n{_line(names)}\n|{"---|" * len(names)}')
    for row in rows:
        print(_line(row), flush=True)


def _line(cells):
    return f'| {" | ".join(map(str, cells))} |'
