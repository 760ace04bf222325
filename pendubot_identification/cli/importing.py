# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``pendubot import``: a motion from a file with columns into a bag."""

from __future__ import annotations

import argparse
import math

from pendubot_identification.errors import UsageError, wrong_usage
from pendubot_identification.recordings.joint_states import write_trajectory
from pendubot_identification.recordings.survey import as_text, survey_table
from pendubot_identification.recordings.table_reader import TableReader
from pendubot_identification.recordings.tables import FORMATS, is_table

from .options import conversion_of
from .terminal import progress_bar


def run(args: argparse.Namespace) -> int:
    """Import a motion and describe it."""
    with wrong_usage():
        conversion = conversion_of(args)
    if not is_table(args.file):
        raise UsageError(
            f'{args.file} is no file with columns; one whose name ends in {", ".join(FORMATS)} is expected'
        )
    reader = TableReader(args.file, conversion)
    with progress_bar() as progress:
        progress(f'reading {args.file.name}', 0, 0, math.nan)
        motion = reader.motion

        def report(done: int) -> None:
            progress(f'writing {args.output.name}', done, len(motion), math.nan)

        write_trajectory(args.output, motion, overwrite=args.force, progress=report)
    print(f'{args.output}: {as_text(survey_table(reader))}')
    return 0
