# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``identifier``: parameters from windows of recorded bags, latched on pendubot/params."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.task import Future

from pendubot_identification.errors import ResultError
from pendubot_identification.files import refuse_input, refuse_unwritable, write_atomically
from pendubot_identification.identify.options import APPLY_REMEDIES, CRITERION, DELAY, DELAYS, OPTIONS, PER_VECTOR
from pendubot_identification.identify.settings import Settings
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import MODELS, NAMES, Bounds, default_bounds
from pendubot_identification.recordings.bag_reader import BagWindow
from pendubot_identification.recordings.datasets import load_datasets
from pendubot_identification.report.tables import headline, summary
from pendubot_identification.results.assemble import assemble_result
from pendubot_identification.results.corrections import identify_recordings
from pendubot_identification.results.options import settings_of
from pendubot_identification.results.result import Result, plain
from pendubot_identification.results.result_file import result_text
from pendubot_identification.setting import Setting
from pendubot_identification.trajectories.conventions import CONVERSION

from .messages import Identification, Status, flat, parameter_values
from .runtime import JOINTS, SettingsNode, explained, run
from .topics import check_names

#: Time between two log lines of one step [s]; the beginning of a step is logged at once.
LOG_PERIOD = 5.0
#: The parameter that lets an existing result file be overwritten.
FORCE = 'force:=true'


def _options() -> Iterator[Setting]:
    """Yield the options of an identification as ROS parameters."""
    for option in OPTIONS:
        if option is DELAY:
            for name, end, default in zip(('delay_min', 'delay_max'), ('least', 'greatest'), DELAYS, strict=True):
                yield replace(option, name=name, default=default, description=f'{option.description}: the {end}')
        elif option is CRITERION:
            yield replace(option, choices=())  # the text names several of them
        elif option is not PER_VECTOR:
            yield option


class Identifier(SettingsNode):
    """Identifies at the start where bags are named, and again at every call of ~/identify; stays alive."""

    PROGRAM = 'identifier'
    SUMMARY = (
        'Estimates the parameters of a rig from recorded bags and publishes them, latched, on pendubot/params, with '
        'their quality on pendubot/identification. Set its parameters and call ~/identify to identify again: it '
        'answers when the result is there, with success unless that failed or is of level ERROR.'
    )
    SETTINGS = tuple(
        replace(each, dynamic=True)
        for each in (
            Setting('bags', [''], 'bags or files with columns that estimate, each BAG[@START:END] in seconds'),
            Setting('validate', [''], 'bags that only validate; by default the rest of the bags'),
            Setting('topic', 'joint_states', 'topic with the joint states in the bags'),
            JOINTS,
            *_options(),
            *CONVERSION,
            APPLY_REMEDIES,
            Setting('lower_bounds', default_bounds().lower.tolist(), f'of {" ".join(NAMES)}, in their units'),
            Setting('upper_bounds', default_bounds().upper.tolist(), f'of {" ".join(NAMES)}, in their units'),
            Setting('output', '', 'result file to write; empty: none'),
            Setting('force', False, 'whether an existing result file is overwritten'),
        )
    )

    def _open(self, s: dict[str, Any]) -> None:
        self._identification = Identification(self)
        # The progress on /diagnostics, replaced as a whole so that no thread sees half of it; and the step of the
        # computation, when it began and was logged last [s].
        self._progress: tuple[Level, str, dict[str, object]] = (Level.OK, 'waiting for ~/identify', {})
        self._step, self._step_began, self._logged = '', 0.0, 0.0
        Status(self, lambda: self._progress, ': progress')
        self._outcome: Future | None = None
        self.serve('~/identify', self._on_identify)
        if _named(s['bags']):
            self._start(s)
        else:
            self.get_logger().info('waiting: set the parameter bags and call ~/identify')

    def _check(self, s: dict[str, Any]) -> None:
        _settings(s)
        check_names([s['topic']], 'topic')

    async def _on_identify(self) -> tuple[bool, str]:
        s = self.settings()
        if self._outcome is not None and not self._outcome.done():
            return False, 'an identification is under way; wait for its result on /pendubot/identification'
        if not _named(s['bags']):
            return False, 'no bags are named; set the parameter bags, such as ["swing@0:9"]'
        level, text = await self._start(s)
        return level is not Level.ERROR, text

    def _start(self, s: dict[str, Any]) -> Future:
        """Identify in a thread of its own, so that the node answers meanwhile; return level and headline to come."""
        self._outcome = Future()
        threading.Thread(target=self._work, args=(s, self._outcome), daemon=True).start()
        return self._outcome

    def _work(self, s: dict[str, Any], outcome: Future) -> None:
        try:
            level, text = self._identify(s)
        except Exception as error:
            level, text = Level.ERROR, explained(error)
            self.get_logger().error(text)
            self._identification.publish(level, text, {})
        self._step, self._progress = '', (level, text, {})
        self.answer(outcome, (level, text))

    def _on_progress(self, step: str, done: int, of: int, best: float) -> None:
        """Take the step, how much of it is done, of how much (0: not known), and the best J or NaN."""
        now = time.monotonic()
        begins = step != self._step
        if begins:
            self._step, self._step_began = step, now
        values: dict[str, object] = {'step': step, 'done': done, 'of': of or 'not known'}
        if not math.isnan(best):
            values['J'] = best
        if of and done:
            values['seconds_left'] = round((now - self._step_began) * (of - done) / done, 1)
        text = step + (f', {done} of {of}' if of else '') + ('' if math.isnan(best) else f', J = {best:.4e}')
        self._progress = (Level.OK, text, values)
        if begins or now - self._logged >= LOG_PERIOD:
            self._logged = now
            self.get_logger().info(text)

    def _identify(self, s: dict[str, Any]) -> tuple[Level, str]:
        settings = _settings(s)
        bags, validation = _named(s['bags']), _named(s['validate'])
        output = Path(s['output']) if s['output'] else None
        if output is not None:
            read = [BagWindow.parse(bag).path for bag in bags + validation]
            refuse_input(output, [*read, Path(s['start']) if s['start'] else None])
            refuse_unwritable(output, overwrite=s['force'], force=FORCE)
        # A name in a bag: in this node's namespace if it is relative, but not remapped.
        topic = self.resolve_topic_name(s['topic'], only_expand=True)
        names = s['joint_names']
        found, data = identify_recordings(
            lambda reading: load_datasets(bags, validation, topic=topic, joint_names=names, conversion=reading),
            settings,
            self._on_progress,
            apply_remedies=s['apply_remedies'],
        )
        result = assemble_result(found, data.sources)
        level, text = result.level, headline(result)
        self.log(level, f'identified\n{summary(result)}')
        try:
            if output is not None:
                write_atomically(output, result_text(result), overwrite=s['force'], force=FORCE)
        except ResultError as error:
            # The parameters are none the worse for it, so they are published with their own level.
            level, text = Level.ERROR, str(error)
            self.get_logger().error(text)
        theta = result.theta.vector(result.model)
        self._identification.publish(result.level, headline(result), identification_values(result), theta)
        return level, text


def identification_values(result: Result) -> dict[str, Any]:
    """Return the entries of a result under flat names; matrices and single runs are only in the result file.

    ``P1``, ``P1.std_error``, ``P1.unit``, ``J.training``, ``prediction.error``, ``criterion``, ``bags.0.bag``,
    ``warnings.0``, ``criteria.energy.P1`` ...
    """
    data = plain(result)
    values = parameter_values(data['parameters'])
    for key, entry in data.items():
        if key not in ('parameters', 'criteria', 'covariance', 'covariance_rank'):
            values |= flat(key, entry)
    for name, answer in data['criteria'].items():
        J = {which: answer['J'][which] for which in ('training', 'validation', 'unit')}
        brief = {'level': answer['level'], 'J': J, 'error': answer['prediction']['error']}
        values |= flat(f'criteria.{name}', brief | {n: entry['value'] for n, entry in answer['parameters'].items()})
    return values


def _settings(values: dict[str, Any]) -> Settings:
    lower, upper = values['lower_bounds'], values['upper_bounds']
    bounds = Bounds(np.array(lower), np.array(upper), NAMES[: max(len(lower), MODELS['viscous'])])
    options = {option.name: values[option.name] for option in (*OPTIONS, *CONVERSION) if option.name in values}
    return settings_of(options | {'delay': (values['delay_min'], values['delay_max'])}, bounds)


def _named(bags: list[str]) -> list[str]:
    return [bag for bag in bags if bag]


main = partial(run, Identifier)

if __name__ == '__main__':
    raise SystemExit(main())
