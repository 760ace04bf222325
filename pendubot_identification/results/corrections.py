# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Identifies recordings, on request after applying the corrections that they need."""

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

#: Largest number of corrections, the number of options.
TIMES = 8


def identify_recordings(
    load: Callable[[Conversion], Datasets],
    settings: Settings,
    progress: Progress | None = None,
    *,
    apply_remedies: bool = False,
) -> tuple[Identification, Datasets]:
    """Identify recordings loaded with the settings' conversion; on request, correct it and identify again.

    Raises:
        PendubotError: the recordings cannot be read or are too little informative, and no correction applies.
    """
    given = settings.reading.options()
    remaining, uncorrected = TIMES if apply_remedies else 0, None
    while True:
        applied = settings.applied
        notes = [f'applied, as the recordings need it: {" ".join(applied)}'] if applied else []
        try:
            data = load(settings.reading)
            found = identify(data.training, data.validation, settings, progress, [*data.notes, *notes])
            corrected = found.corrected_conversion
            if corrected is None or not remaining:
                return replace(found, uncorrected=uncorrected), data
            uncorrected = uncorrected or found
        except PendubotError as error:
            if not (remaining and error.remedy):
                raise
            corrected = Conversion.of(settings.reading.words() | error.remedy)
            if corrected == settings.reading:
                raise
        remaining -= 1
        settings = replace(settings, reading=corrected, applied=tuple(o for o in corrected.options() if o not in given))
