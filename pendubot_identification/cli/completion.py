# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot completion``: what makes a shell complete subcommands, options, their choices and names of files."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from typing import Any

from pendubot_identification.errors import PendubotError

SHELLS = ('bash', 'zsh', 'fish')
#: What stands for a file or a folder.
FILES = re.compile('BAG|FILE|DIR|yaml')
DESCRIPTION = """\
Print a script that makes a shell complete subcommands, options, their choices and the names of files. It is made by
shtab (pip install shtab) and asks no program, so it costs nothing; make it again after an update. Once:

  bash   pendubot completion bash > ~/.local/share/bash-completion/completions/pendubot
  zsh    pendubot completion zsh > ~/.zfunc/_pendubot     with fpath+=~/.zfunc before compinit in ~/.zshrc
  fish   pendubot completion fish > ~/.config/fish/completions/pendubot.fish

or for this shell alone, bash: source <(pendubot completion bash)"""


def add_parser(subparsers: Any) -> None:
    """Add this subcommand."""
    parser = subparsers.add_parser('completion', help='make a shell complete all this', description=DESCRIPTION)
    parser.add_argument('shell', choices=SHELLS, help='which one')
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Print the script.

    Raises:
        PendubotError: shtab is not installed.
    """
    try:
        import shtab
    except ImportError as error:
        raise PendubotError('completion is made by shtab, which is not installed: pip install shtab') from error
    for action in _actions(args.top):
        if FILES.search(str(action.metavar)):
            action.complete = shtab.FILE  # type: ignore[attr-defined]
    print(shtab.complete(args.top, args.shell))
    return 0


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Return the arguments of a parser and of its subcommands."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                yield from _actions(inner)
