# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``tracker``: estimates the present parameters of a rig from joint_states, latched on pendubot/params."""

import threading
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from pendubot_identification.errors import BagError
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.model.parameters import MODELS
from pendubot_identification.recordings.joint_states import JointDecoder
from pendubot_identification.recordings.mcap_file import Messages
from pendubot_identification.results.track_file import effort_timing, parameters, start_of
from pendubot_identification.setting import Setting
from pendubot_identification.tracking import tracker as tracking
from pendubot_identification.tracking.events import Disturbance, Event, Lost, State

from .messages import Identification, Status, flat, parameter_values
from .ownership import name_rivals
from .runtime import AUTOSTART, JOINTS, ManagedNode, explained, run
from .topics import DEPTH, received, subscribe

#: Period of fetching and processing messages [s].
PERIOD = 0.1
#: Ratio to the published standard error below which a new standard error is published.
NARROWER = 0.5


class Tracker(ManagedNode):
    """Estimates in a separate thread, so that services stay available, and publishes changed parameters."""

    PROGRAM = 'tracker'
    SUMMARY = (
        'Tracks the parameters of a moving rig: publishes them, latched, on pendubot/params if they have changed by '
        'more than their 95 % intervals, with their quality and the last change on pendubot/identification. ~/hold '
        'keeps the published parameters, ~/reset restarts the tracking.'
    )
    SETTINGS = (
        JOINTS,
        Setting('start', '', 'result file with initial parameters; empty: the first motion is identified', path=True),
        Setting('model', 'coulomb', 'model without a start', choices=tuple(MODELS)),
        Setting('rate', 1.0, 'highest rate of published parameters', 'Hz', 0.01, 10.0, dynamic=True),
        AUTOSTART,
    )

    def _open(self, s: dict[str, Any]) -> None:
        self._tracker = tracking.Tracker(start_of(Path(s['start'])) if s['start'] else start_of(None, s['model']))
        self._identification = Identification(self)
        self._decode = JointDecoder(s['joint_names'], self.resolve_topic_name('joint_states'))
        self._joint_states = subscribe(self, 'joint_states', JointState, DEPTH)
        self._rivals = self._unreadable = ''  # sentences on several publishers, and on messages that are not decoded
        self._first_ns: int | None = None
        self._taken = self._disturbances = 0
        # The published state, the last message about it, and its time on the samples' clock [s].
        self._published: State | None = None
        self._last_quality: tuple[Any, ...] = ()
        self._published_at = -np.inf
        self._last_change = 'none'
        self._held = self._restart = False
        self.create_service(SetBool, '~/hold', self._on_hold)
        self.serve('~/reset', self._on_reset)
        Status(self, self._diagnosis)
        self._closing = threading.Event()
        self._worker = self.compute(self._work, self._closing)
        self.get_logger().info(self._tracker.waiting)

    def _activate(self) -> None:
        self._restart = self._taken > 0

    def _close(self) -> None:
        """End the thread, without waiting for a running identification."""
        self._closing.set()
        self._worker.join(1.0)

    def _on_hold(self, request: SetBool.Request, _: SetBool.Response) -> SetBool.Response:
        self._held = request.data
        message = 'the published parameters are held' if self._held else 'changed parameters are published'
        return SetBool.Response(success=True, message=message)

    async def _on_reset(self) -> tuple[bool, str]:
        self._restart = True
        return True, 'the tracking restarts with the next motion'

    def _work(self, closing: threading.Event) -> None:
        while not closing.wait(PERIOD):
            try:
                if self._restart:
                    self._restart = False
                    self._tracker.reset()
                    self._published = None
                messages = self._take()
                if not self.active:
                    continue
                if messages:
                    self._estimate(messages)
                if not self._held:
                    self._publish()
            except Exception as error:  # no other thread would report it
                self.get_logger().error(explained(error), throttle_duration_sec=10.0)

    def _take(self) -> list[bytes]:
        """Return the received messages; of several publishers none, and the tracking restarts: their rig is unknown."""
        messages = [data for data, _ in received(self._joint_states)]
        before, self._rivals = self._rivals, name_rivals(self, self._joint_states, wait=True)
        if self._rivals and not before:
            self.get_logger().error(self._rivals)
        if self._rivals or before:
            self._restart = True
            return []
        return messages

    def _estimate(self, messages: list[bytes]) -> None:
        try:
            stamps, values = self._decode(Messages.of(messages))
        except BagError as error:
            self._unreadable = str(error)
            self.get_logger().error(self._unreadable, throttle_duration_sec=10.0)
            return
        self._unreadable = ''
        if self._first_ns is None:
            self._first_ns = int(stamps[0])
        self._taken += len(stamps)
        t = (stamps - self._first_ns) / 1e9
        for event in self._tracker.feed(np.column_stack([t, values[:, 0], values[:, 1]])):
            if not isinstance(event, State):
                self._on_event(event)

    def _on_event(self, event: Event) -> None:
        if isinstance(event, Disturbance):
            self._disturbances += 1
            self.get_logger().info(str(event))
            return
        self._last_change = str(event)
        self._published = None if isinstance(event, Lost) else self._published
        # The published parameters are wrong after a change, so the next ones do not wait.
        self._published_at = -np.inf
        self.get_logger().warning(str(event))

    def _publish(self) -> None:
        state = self._tracker.state
        if self._rivals or self._unreadable or state is None:
            self._report(*self._condition(), {})
            return
        if state.t - self._published_at < 1 / self.get_parameter('rate').value and state.t >= self._published_at:
            return
        if moved := self._moved(state):
            if self._published is None:
                self.get_logger().info(f'tracking, level {state.level.name}: {self._condition()[1]}')
            self._published, self._published_at = state, state.t
        # The message describes the published parameters, for their receivers.
        self._report(*self._condition(), self._values(self._published or state), state.theta if moved else None)

    def _moved(self, state: State) -> bool:
        last = self._published
        if last is None:
            return True
        moved = np.abs(state.theta - last.theta) > NORMAL_95 * state.std_error
        return bool(moved.any() or (state.std_error < NARROWER * last.std_error).any())

    def _condition(self) -> tuple[Level, str]:
        """Return the level of the estimate and a sentence."""
        state = self._tracker.state
        if trouble := self._rivals or self._unreadable:
            return Level.ERROR, trouble
        if state is None:
            return Level.WARN, self._tracker.waiting
        return state.level, '; '.join(state.warnings) or 'tracked'

    def _values(self, state: State) -> dict[str, Any]:
        values = parameter_values({name: asdict(entry) for name, entry in parameters(state).items()})
        segment_settings = self._tracker.segment_settings
        if segment_settings is not None:
            values |= flat('effort', asdict(effort_timing(state, segment_settings)))
            values['model'] = segment_settings.model
        return values | {'criterion': 'weak, tracked', 'last_change': self._last_change}

    def _report(self, level: Level, text: str, values: dict[str, Any], theta: Any = None) -> None:
        """Publish the quality if it differs from the last message, except in the digits of its text."""
        key = level, ''.join(c for c in text if not c.isdigit()), values
        if key != self._last_quality or theta is not None:
            self._last_quality = key
            self._identification.publish(level, text, values, theta)

    def _diagnosis(self) -> tuple[Level, str, dict[str, Any]]:
        state = self._tracker.state
        values = {'samples': self._taken, 'disturbances': self._disturbances, 'last change': self._last_change}
        values |= self._tracker.notes
        if state is not None:
            values |= {'moving': state.moving, 'unexplained torque [N m]': state.unexplained}
        level, text = self._condition()
        return level, ('held; ' if self._held else '') + text, values


main = partial(run, Tracker)
