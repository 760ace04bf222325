# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Sphinx: `make docs` builds these pages, the README and the Python interface into build/docs."""

import re

project = 'pendubot identification'
author = copyright = 'The pendubot_identification authors'
extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
myst_heading_anchors = 3
highlight_language = 'none'
autodoc_member_order = 'bysource'
autodoc_type_aliases = {name: name for name in ('Array', 'ArrayLike', 'File')}
html_theme = 'alabaster'
html_theme_options = {
    'page_width': 'min(1260px, 96%)',
    'sidebar_width': '240px',
    'body_max_width': 'none',
    'code_font_size': '0.75em',
}


def _adapt_links(text: str, folder: str) -> str:
    """Point links to the README and to pages at pages here; replace links to other files by the file's name.

    Args:
        text: of a page.
        folder: from the page to the root of the repository.
    """
    text = re.sub(rf'\]\({folder}README\.md', '](index.md', text)
    text = re.sub(r'(\]\()docs/', r'\1', text) if not folder else text
    outside = re.escape(folder) or r'(?=[a-zA-Z]+/|[A-Z]+\.)'
    return re.sub(rf'(?<!!)\[([^]]+)\]\({outside}([^)#:]+)(?:#[^)]*)?\)', r'\1 (`\2`)', text)


def _read_page(app, name, content):
    content[0] = _adapt_links(content[0], r'../')


def _read_included(app, path, name, content):
    content[0] = _adapt_links(content[0], '')


def setup(app):
    """Adapt the links of every page that is read."""
    app.connect('source-read', _read_page)
    app.connect('include-read', _read_included)
