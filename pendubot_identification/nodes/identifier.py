# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``identifier``: estimates parameters from windows of recorded bags and publishes them latched on pendubot/params."""

import math
import threading
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from std_msgs.msg import String

from pendubot_identification.errors import PendubotError, ResultError
from pendubot_identification.files import refuse_input, refuse_unwritable, write_atomically
from pendubot_identification.formats.export import export
from pendubot_identification.identification import APPLY_REMEDIES, CRITERION, DELAY, DELAYS, OPTIONS, PER_VECTOR
from pendubot_identification.identification.settings import Settings
from pendubot_identification.level import Level
from pendubot_identification.recordings.bag_reader import BagWindow
from pendubot_identification.report.tables import headline, summary
from pendubot_identification.results.computation import Computation
from pendubot_identification.results.options import bounds_of, settings_of
from pendubot_identification.results.result import Result, plain, result_text
from pendubot_identification.setting import Setting
from pendubot_identification.trajectories.conventions import CONVERSION, JOINTS, TOPIC

from . import runtime
from .messages import LATCHED, Identification, Status, flat, parameter_values
from .runtime import AUTOSTART, ManagedNode, explained, run

try:
    from pendubot_interfaces.action import Identify
except ImportError:  # not built, as in a virtual environment
    Identify = None

#: Not robot_description, where a controller_manager would receive a rig without its <ros2_control> element.
ROBOT_DESCRIPTION = 'pendubot/robot_description'
#: Interval of the feedback messages of one step [s].
FEEDBACK_PERIOD = 0.1
#: Changes of identification options as ROS parameters: the text of ``criterion`` may name several criteria.
CHANGED: dict[str, dict[str, Any]] = {CRITERION.name: {'choices': ()}, DELAY.name: {'default': [*DELAYS], 'length': 2}}


class Identifier(ManagedNode):
    """Identifies at activation if bags are set, and at every call of ~/identify; keeps running afterwards."""

    PROGRAM = 'identifier'
    SUMMARY = (
        'Estimates the parameters of a rig from recorded bags and publishes them, latched, on pendubot/params, with '
        'their quality on pendubot/identification and a URDF on pendubot/robot_description. Set its parameters and '
        'call ~/identify to identify again: it answers after the identification, with success unless that failed or '
        'its level is ERROR. The action ~/identify reports progress and can be canceled; it needs pendubot_interfaces.'
    )
    SETTINGS = tuple(
        replace(each, dynamic=each is not AUTOSTART)
        for each in (
            Setting('bags', [''], 'training bags or files with columns, each BAG[@START:END] in seconds', path=True),
            Setting('validate', [''], 'validation bags; by default the rest of the training bags', path=True),
            replace(TOPIC, default='joint_states'),
            runtime.JOINTS,
            *(replace(option, **CHANGED.get(option.name, {})) for option in OPTIONS if option is not PER_VECTOR),
            *(option for option in CONVERSION if option not in (TOPIC, JOINTS)),
            APPLY_REMEDIES,
            Setting('bounds', [''], 'search intervals that replace the defaults, each NAME=LOW:HIGH or NAME=VALUE'),
            Setting('output', '', 'result file to write; empty: none', path=True),
            Setting('force', False, 'whether an existing result file is overwritten'),
            AUTOSTART,
        )
    )

    def _open(self, s: dict[str, Any]) -> None:
        self._identification = Identification(self)
        # The progress on /diagnostics, replaced as one tuple, so that every thread reads a consistent pair; then the
        # step of the computation and the time of its last feedback [s].
        self._progress = Level.OK, 'waiting for ~/identify'
        self._step, self._reported = '', 0.0
        Status(self, lambda: (*self._progress, {}), ': progress')
        self._description = self.create_publisher(String, ROBOT_DESCRIPTION, LATCHED)
        self._outcome: Future | None = None
        self._computation = Computation()
        self._goal: ServerGoalHandle | None = None
        self.serve('~/identify', self._on_identify)
        if Identify is not None:
            group = ReentrantCallbackGroup()
            ActionServer(
                self, Identify, '~/identify', self._on_goal, cancel_callback=self._on_cancel, callback_group=group
            )

    def _activate(self) -> None:
        s = self.settings()
        if s['bags']:
            self._start(s)
        else:
            self.get_logger().info('waiting: set the parameter bags and call ~/identify')

    def _deactivate(self) -> None:
        self._computation.stop()

    _close = _deactivate

    def _check(self, s: dict[str, Any]) -> None:
        self._settings(s)

    def _settings(self, s: dict[str, Any]) -> Settings:
        # The topic's name in a bag is in this node's namespace if it is relative, but not remapped.
        read = {'topic': self.resolved([s['topic']], only_expand=True)[0], 'joints': s['joint_names']}
        options = {option.name: s[option.name] for option in (*OPTIONS, *CONVERSION) if option.name in s} | read
        return settings_of(options, bounds_of(s['bounds']))

    async def _on_identify(self) -> tuple[bool, str]:
        level, text = await self._identified(self.settings())
        return level is not Level.ERROR, text

    async def _on_goal(self, goal: ServerGoalHandle) -> Any:
        request = {'bags': list(goal.request.bags), 'validate': list(goal.request.validate)}
        level, text = await self._identified(self.settings() | {k: v for k, v in request.items() if v}, goal)
        if level is not Level.ERROR:
            goal.succeed()
        elif goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return Identify.Result(level=int(level), message=text)

    def _on_cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        if goal is self._goal:
            self._computation.stop()
        return CancelResponse.ACCEPT

    async def _identified(self, s: dict[str, Any], goal: ServerGoalHandle | None = None) -> tuple[Level, str]:
        """Identify, and report progress to the goal of an action; return level and headline."""
        if not self.active:
            name = self.get_fully_qualified_name()
            return Level.ERROR, f'the identifier is inactive; call ros2 lifecycle set {name} activate'
        if self._outcome is not None and not self._outcome.done():
            return Level.ERROR, 'an identification is under way; wait for its result on pendubot/identification'
        if not s['bags']:
            return Level.ERROR, 'no bags are named; set the parameter bags, such as ["swing@0:9"]'
        return await self._start(s, goal)

    def _start(self, s: dict[str, Any], goal: ServerGoalHandle | None = None) -> Future:
        """Start the identification in its own process, while the node answers; return a future level and headline."""
        self._outcome, self._computation, self._goal = Future(), Computation(), goal
        threading.Thread(target=self._work, args=(s, self._computation, self._outcome), daemon=True).start()
        return self._outcome

    def _work(self, s: dict[str, Any], computation: Computation, outcome: Future) -> None:
        try:
            level, text = self._identify(s, computation)
        except Exception as error:
            level, text = Level.ERROR, explained(error)
            self.get_logger().error(text)
            if not computation.stopped:
                self._identification.publish(level, text, {})
        self._step, self._progress = '', (level, text)
        self.answer(outcome, (level, text))

    def _on_progress(self, step: str, done: int, of: int, best: float) -> None:
        """Report the step, its completed and total amount (0: unknown), and the best J or NaN."""
        now = time.monotonic()
        begins, self._step = step != self._step, step
        text = step + (f', {done} of {of}' if of else '') + ('' if math.isnan(best) else f', J = {best:.4e}')
        self._progress = Level.OK, text
        if begins:
            self.get_logger().info(text)
        if self._goal is not None and (begins or now - self._reported >= FEEDBACK_PERIOD):
            self._reported = now
            self._goal.publish_feedback(Identify.Feedback(stage=step, fraction=done / of if of else math.nan))

    def _identify(self, s: dict[str, Any], computation: Computation) -> tuple[Level, str]:
        settings = self._settings(s)
        output = Path(s['output']) if s['output'] else None
        if output is not None:
            read = [BagWindow.parse(bag).path for bag in s['bags'] + s['validate']]
            refuse_input(output, [*read, Path(s['start']) if s['start'] else None])
            refuse_unwritable(output, overwrite=s['force'])
        result = computation.run(
            s['bags'], s['validate'], settings, self._on_progress, apply_remedies=s['apply_remedies']
        )
        level, text = result.level, headline(result)
        self.log(level, f'identified\n{summary(result)}')
        try:
            if output is not None:
                write_atomically(output, result_text(result), overwrite=s['force'])
        except ResultError as error:
            # The parameters are still valid, so they are published with their own level.
            level, text = Level.ERROR, str(error)
            self.get_logger().error(text)
        theta = result.theta.vector(result.model)
        self._identification.publish(result.level, headline(result), identification_values(result), theta)
        self._describe(result, s['link_length'])
        return level, text

    def _describe(self, result: Result, link_length: float) -> None:
        """Publish the rig as a URDF, if the parameters correspond to physical masses."""
        try:
            text, _ = export(result, 'urdf', link_length or None)
        except PendubotError as error:
            self.get_logger().warning(f'{ROBOT_DESCRIPTION} is not published: {error}')
        else:
            self._description.publish(String(data=text))


def identification_values(result: Result) -> dict[str, Any]:
    """Return the entries of a result under flat names, without matrices and single runs.

    ``P1``, ``P1.std_error``, ``P1.unit``, ``J.training``, ``prediction.error``, ``criterion``, ``bags.0.bag``,
    ``warnings.0``, ``criteria.energy.P1`` ...
    """
    data = plain(result)
    values = parameter_values(data['parameters'])
    for key, entry in data.items():
        if key not in ('parameters', 'criteria', 'covariance'):
            values |= flat(key, entry)
    for name, answer in data['criteria'].items():
        J = {key: answer['J'][key] for key in ('training', 'validation', 'unit')}
        brief = {'level': answer['level'], 'J': J, 'error': answer['prediction']['error']}
        values |= flat(f'criteria.{name}', brief | {n: entry['value'] for n, entry in answer['parameters'].items()})
    return values


main = partial(run, Identifier)
