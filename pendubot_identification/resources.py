# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Finds the package's config and bags in every kind of install (colcon, colcon --symlink-install, pip, pip -e)."""

from pathlib import Path

from pendubot_identification.errors import PendubotError

NAME = 'pendubot_identification'


def resource(relative: str) -> Path:
    """Return the path of a file or folder such as ``config/bridge.yaml`` or ``bags/paper_experiment``.

    The search covers the source tree of the imported package, and ``share/pendubot_identification`` in every folder
    above the package (an install).

    Raises:
        PendubotError: the file is in none of these places.
    """
    package = Path(__file__).resolve().parent
    places = [package.parent] if (package.parent / 'package.xml').exists() else []
    places += [above / 'share' / NAME for above in Path(__file__).absolute().parents]
    places += [above / 'share' / NAME for above in package.parents]
    for place in places:
        if (place / relative).exists():
            return place / relative
    raise PendubotError(f'{relative} is not part of this install of {NAME}; install the package again')
