# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Identifies recordings, on request with corrections, also in a process that can be stopped at any time.

A thread cannot be stopped: some stages take seconds between two reports of progress.
"""

import os
import pickle
import subprocess
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from subprocess import PIPE
from typing import Any

from pendubot_identification.errors import PendubotError, noting, sentence
from pendubot_identification.identification.conventions import corrected_conversion
from pendubot_identification.identification.estimate import Progress
from pendubot_identification.identification.pipeline import identify
from pendubot_identification.identification.settings import Settings
from pendubot_identification.recordings.datasets import Datasets, load_datasets
from pendubot_identification.trajectories.conversion import Conversion

from .assemble import assemble_result
from .result import Result

#: Largest number of corrections.
CORRECTIONS = 8


def identify_recordings(
    load: Callable[[Conversion], Datasets],
    settings: Settings,
    progress: Progress | None = None,
    *,
    apply_remedies: bool = False,
) -> tuple[Result, Datasets]:
    """Identify recordings loaded with the settings' conversion; on request, correct it and identify again.

    Raises:
        PendubotError: the recordings cannot be read or are not informative enough, and no correction applies.
    """
    requested = settings.reading.options()
    remaining, uncorrected = CORRECTIONS if apply_remedies else 0, None
    while True:
        applied = settings.applied
        notes = [f'applied corrections of the recordings: {" ".join(applied)}'] if applied else []
        try:
            data = load(settings.reading)
            with noting(data.notes):
                found = identify(data.training, data.validation, settings, progress, [*data.notes, *notes])
            corrected = corrected_conversion(found.faults)
            if corrected is None or not remaining:
                return assemble_result(replace(found, uncorrected=uncorrected), data.sources), data
            uncorrected = uncorrected or found
        except PendubotError as error:
            if not (remaining and error.remedy):
                raise
            corrected = Conversion.of(settings.reading.words() | error.remedy)
            if corrected == settings.reading:
                raise
        remaining -= 1
        applied = tuple(option for option in corrected.options() if option not in requested)
        settings = replace(settings, reading=corrected, applied=applied)


class Computation:
    """The child process of one identification: one thread runs it, and any thread may stop it.

    Attributes:
        stopped: whether it was stopped.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self.stopped = False

    def stop(self) -> None:
        """Kill the process, or prevent its start."""
        self.stopped = True
        if self._process is not None:
            self._process.kill()

    def run(
        self,
        bags: Sequence[str],
        validate: Sequence[str],
        settings: Settings,
        progress: Progress,
        *,
        apply_remedies: bool = False,
    ) -> Result:
        """Identify bags, see :func:`load_datasets`. Raises PendubotError: the identification failed or was stopped."""
        request = partial(load_datasets, bags, validate), settings, apply_remedies
        # The modules of this process, not of the current folder.
        code = f'import sys; sys.path[:] = {sys.path!r}; from {__name__} import main; main()'
        command = [sys.executable, '-c', code, *(['--debug'] if '--debug' in sys.argv else [])]
        # A separate session, so that a Ctrl-C in the terminal reaches the node alone.
        with subprocess.Popen(command, stdin=PIPE, stdout=PIPE, start_new_session=True) as process:
            self._process = process
            assert process.stdin is not None
            assert process.stdout is not None
            if self.stopped:
                process.kill()
            try:
                # Without a buffer, whose flush at the end of the context would fail again if the process was killed.
                os.write(process.stdin.fileno(), pickle.dumps(request))
                while isinstance(answer := pickle.load(process.stdout), tuple):
                    progress(*answer)
            except (EOFError, OSError, pickle.UnpicklingError):
                process.kill()
                answer = f'the process of the identification ended with status {process.wait()}; look at the system log'
        if self.stopped or isinstance(answer, str):
            raise PendubotError('the identification was canceled' if self.stopped else answer)
        return answer


def main() -> None:
    """Read a request; write progress as tuples, then the result or an error message."""
    # Printed text must not mix with the answers.
    answers = os.fdopen(os.dup(1), 'wb')
    os.dup2(2, 1)

    def send(answer: Any) -> None:
        pickle.dump(answer, answers)
        answers.flush()

    load, settings, apply_remedies = pickle.load(sys.stdin.buffer)
    try:
        send(identify_recordings(load, settings, lambda *step: send(step), apply_remedies=apply_remedies)[0])
    except BrokenPipeError:
        os._exit(1)  # the node has ended
    except Exception as error:
        if '--debug' in sys.argv:
            traceback.print_exception(error)
        send(sentence(error))
