# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot studio``: the guided way, in a browser."""

from __future__ import annotations

import argparse

from pendubot_identification.errors import PendubotError


def run(args: argparse.Namespace) -> int:
    """Serve the studio until a signal."""
    try:
        from pendubot_identification.studio.server import serve
    except ImportError as error:
        raise PendubotError(
            f'{error.name} cannot be imported, and the studio needs aiohttp: pip install aiohttp'
        ) from error
    serve(args.files, args.port, browser=not args.no_browser, debug=args.debug)
    return 0
