# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Tables in Markdown, row by row."""


def line(*cells):
    """Return a row."""
    return f'| {" | ".join(map(str, cells))} |'


def head(*names):
    """Return the head of a table: the names of the columns, and the line below them."""
    return f'{line(*names)}\n|{"---|" * len(names)}'
