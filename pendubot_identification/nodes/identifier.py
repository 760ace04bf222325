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
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from pendubot_identification.errors import ParameterError, PendubotError, ResultError
from pendubot_identification.files import refuse_input, refuse_unwritable, write_atomically
from pendubot_identification.identify.options import APPLY_REMEDIES, CRITERION, DELAY, DELAYS, OPTIONS, PER_VECTOR
from pendubot_identification.identify.settings import Settings
from pendubot_identification.level import Level
from pendubot_identification.model.parameters import MODELS, NAMES, Bounds, default_bounds
from pendubot_identification.recordings.bag_reader import BagWindow
from pendubot_identification.recordings.datasets import load_datasets
from pendubot_identification.recordings.joint_states import JOINT_NAMES
from pendubot_identification.report.tables import headline, summary
from pendubot_identification.results.assemble import assemble_result
from pendubot_identification.results.corrections import identify_recordings
from pendubot_identification.results.options import settings_of
from pendubot_identification.results.result_file import result_text
from pendubot_identification.setting import Setting
from pendubot_identification.trajectories.conventions import CONVERSION

from .diagnostics import StatusPublisher, diagnostics_message, stamp_now
from .messages import LATCHED, identification_values, parameters_message
from .runtime import SettingsNode, run
from .shutdown import Shutdown
from .topics import check_names

#: Between two log lines of one step [s]; the beginning of a step is said at once.
LOG_PERIOD = 5.0
#: What the user sets to have an existing result file overwritten.
FORCE = 'force:=true'


def _parameters() -> Iterator[Setting]:
    """Yield the options of an identification as ROS parameters."""
    for option in OPTIONS:
        if option is DELAY:
            for name, end, default in zip(('delay_min', 'delay_max'), ('least', 'greatest'), DELAYS, strict=True):
                words = f'{option.description}: the {end}'
                yield replace(option, name=name, default=default, description=words, dynamic=True)
        elif option is CRITERION:
            yield replace(option, choices=(), dynamic=True)  # the text names several of them
        elif option is not PER_VECTOR:
            yield replace(option, dynamic=True)


class Progress:
    """How far an identification has come: log lines at a decent rate, and a status on /diagnostics once a second."""

    def __init__(self, node: SettingsNode, idle: str) -> None:
        self._node = node
        # Replaced as a whole, so that the timer's thread never sees half of it.
        self._state: tuple[Level, str, dict[str, object]] = (Level.OK, idle, {})
        self._step, self._step_began, self._logged = '', 0.0, 0.0
        tell = StatusPublisher(node, ': progress')
        node.create_timer(1.0, lambda: tell(*self._state))

    def __call__(self, what: str, done: int, of: int, best: float) -> None:
        """Take what is being done, how much of it is done, of how much (0: not known), and the best J or NaN."""
        now = time.monotonic()
        begins = what != self._step
        if begins:
            self._step, self._step_began = what, now
        values: dict[str, object] = {'step': what, 'done': done, 'of': of or 'not known'}
        if not math.isnan(best):
            values['J'] = best
        if of and done:
            values['seconds_left'] = round((now - self._step_began) * (of - done) / done, 1)
        summary = what + (f', {done} of {of}' if of else '') + ('' if math.isnan(best) else f', J = {best:.4e}')
        self._state = (Level.OK, summary, values)
        if begins or now - self._logged >= LOG_PERIOD:
            self._logged = now
            self._node.get_logger().info(summary)

    def ended(self, level: Level, summary: str) -> None:
        """Say how the work ended; the next call begins anew."""
        self._step = ''
        self._state = (level, summary, {})


class Identifier(SettingsNode):
    """Identifies at the start where bags are named, and again at every call of ~/identify; stays alive."""

    PROGRAM = 'identifier'
    SUMMARY = (
        'Estimates the parameters of a rig from recorded bags and publishes them, latched, on pendubot/params, with '
        'everything that says how far to trust them on pendubot/identification. Set its parameters and call '
        '~/identify to identify again.'
    )
    SETTINGS = (
        Setting(
            'bags',
            [''],
            'bags or files with columns that estimate, each BAG[@START:END] in seconds from its first sample',
            dynamic=True,
        ),
        Setting('validate', [''], 'bags that only judge; by default what the windows leave', dynamic=True),
        Setting('topic', 'joint_states', 'topic with the joint states in the bags', dynamic=True),
        Setting('joint_names', list(JOINT_NAMES), 'their joint names: shoulder, elbow', dynamic=True),
        *_parameters(),
        *(replace(option, dynamic=True) for option in (*CONVERSION, APPLY_REMEDIES)),
        Setting('lower_bounds', default_bounds().lower.tolist(), f'of {" ".join(NAMES)}, in their units', dynamic=True),
        Setting('upper_bounds', default_bounds().upper.tolist(), f'of {" ".join(NAMES)}, in their units', dynamic=True),
        Setting('output', '', 'result file to write; empty: none', dynamic=True),
        Setting('force', False, 'whether an existing result file is overwritten', dynamic=True),
    )

    def __init__(self, ended: Shutdown) -> None:
        super().__init__(ended)
        self._params = self.create_publisher(Float64MultiArray, 'pendubot/params', LATCHED)
        self._identification = self.create_publisher(DiagnosticArray, 'pendubot/identification', LATCHED)
        self.create_service(Trigger, '~/identify', self._on_identify)
        self._progress = Progress(self, 'waiting for ~/identify')
        self._worker: threading.Thread | None = None
        if _named(self.settings()['bags']):
            self._start()
        else:
            self.get_logger().info('waiting: set the parameter bags and call ~/identify')

    def close(self) -> None:
        """Leave a computation that is under way: it holds nothing that could be lost."""

    def _on_identify(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._worker is not None and self._worker.is_alive():
            response.message = 'an identification is under way; wait for its result on /pendubot/identification'
        elif not _named(self.settings()['bags']):
            response.message = 'no bags are named; set the parameter bags, such as ["swing@0:9"]'
        else:
            self._start()
            response.success = True
            response.message = 'started; the result comes on /pendubot/params and /pendubot/identification'
        return response

    def _start(self) -> None:
        """Identify in a thread of its own, so that the node answers meanwhile."""
        self._worker = threading.Thread(target=self._work, args=(self.settings(),), daemon=True)
        self._worker.start()

    def _work(self, values: dict[str, Any]) -> None:
        try:
            self._identify(values)
        except Exception as error:
            known = isinstance(error, PendubotError)
            self._failed(str(error) if known else f'{type(error).__name__}: {error}')

    def _identify(self, values: dict[str, Any]) -> None:
        settings = _settings(values)
        bags, validation = _named(values['bags']), _named(values['validate'])
        output = Path(values['output']) if values['output'] else None
        if output is not None:
            read = [BagWindow.parse(bag).path for bag in bags + validation]
            refuse_input(output, [*read, Path(values['start']) if values['start'] else None])
            refuse_unwritable(output, overwrite=values['force'], force=FORCE)
        # A name in a bag: in this node's namespace if it is relative, but not remapped.
        topic = self.resolve_topic_name(values['topic'], only_expand=True)
        names = values['joint_names']
        found, data = identify_recordings(
            lambda reading: load_datasets(bags, validation, topic=topic, joint_names=names, conversion=reading),
            settings,
            self._progress,
            apply_remedies=values['apply_remedies'],
        )
        result = assemble_result(found, data.sources)
        unwritten = ''
        try:
            if output is not None:
                write_atomically(output, result_text(result), overwrite=values['force'], force=FORCE)
        except ResultError as error:
            unwritten = str(error)
        # Two lines, because rclpy keeps a severity for each line that logs.
        if result.level is Level.OK:
            self.get_logger().info(f'identified\n{summary(result)}')
        else:
            self.get_logger().warning(f'identified\n{summary(result)}')
        # The judgement first, so that whoever hears the parameters can already know how good they are; and both last,
        # so that whoever hears them can already have them identified again.
        self._publish(result.level, headline(result), identification_values(result))
        self._params.publish(parameters_message(result))
        if unwritten:
            # The parameters are none the worse for it, so their judgement stands.
            self.get_logger().error(unwritten)
            self._progress.ended(Level.ERROR, unwritten)

    def _failed(self, sentence: str) -> None:
        self.get_logger().error(sentence)
        self._publish(Level.ERROR, sentence, {})

    def _publish(self, level: Level, headline: str, values: dict[str, Any]) -> None:
        self._progress.ended(level, headline)
        message = diagnostics_message(stamp_now(self), 'pendubot identification', level, headline, values)
        self._identification.publish(message)

    def check(self, values: dict[str, Any]) -> None:
        """Refuse settings that make no sense together."""
        _settings(values)
        check_names([values['topic']], 'topic')
        if len(values['joint_names']) != 2:
            raise ParameterError(f'joint_names are {values["joint_names"]}; two are expected, shoulder and elbow')


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
