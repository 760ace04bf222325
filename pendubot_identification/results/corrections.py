# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings in, an identification out; where it is asked for, after what the recordings themselves ask for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from pendubot_identification.errors import PendubotError
from pendubot_identification.identify.estimate import Progress
from pendubot_identification.identify.identification import Identification
from pendubot_identification.identify.pipeline import identify
from pendubot_identification.identify.settings import Settings
from pendubot_identification.recordings.datasets import Datasets
from pendubot_identification.trajectories.conversion import Conversion

#: Remedies are applied no more often than there are options.
TIMES = 8


def identify_recordings(
    load: Callable[[Conversion], Datasets],
    settings: Settings,
    progress: Progress | None = None,
    *,
    apply_remedies: bool = False,
) -> tuple[Identification, Datasets]:
    """Identify what is loaded with the settings' conversion; apply the remedies that are named, and identify again.

    Raises:
        PendubotError: the recordings cannot be read, or tell too little, and no remedy is known or asked for.
    """
    given = settings.reading.options()
    for left in reversed(range(TIMES + 1)):
        applied = settings.applied
        notes = [f'applied, as the recordings ask for it: {" ".join(applied)}'] * bool(applied)
        try:
            data = load(settings.reading)
            found = identify(data.training, data.validation, settings, progress, [*data.notes, *notes])
            mended = found.mended
        except PendubotError as error:
            if not (apply_remedies and left and error.remedy):
                raise
            mended = Conversion.of(settings.reading.words() | error.remedy)
            if mended == settings.reading:
                raise
        if mended is None or not apply_remedies or not left:
            return found, data
        settings = replace(settings, reading=mended, applied=tuple(o for o in mended.options() if o not in given))
    raise AssertionError('the last time returns or raises')
