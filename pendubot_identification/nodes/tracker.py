# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""``tracker``: what a rig's parameters are now, by its joint_states, latched on pendubot/params."""

from __future__ import annotations

import threading
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from pendubot_identification.errors import ParameterError, PendubotError
from pendubot_identification.level import NORMAL_95, Level
from pendubot_identification.model.parameters import MODELS
from pendubot_identification.recordings.joint_states import JOINT_NAMES, JointDecoder
from pendubot_identification.recordings.mcap_file import Messages
from pendubot_identification.results.track_file import effort_taken, parameters, start_of
from pendubot_identification.setting import Setting
from pendubot_identification.tracking import tracker as tracking
from pendubot_identification.tracking.events import Disturbance, Event, Lost, State

from .diagnostics import StatusPublisher, diagnostics_message, stamp_now
from .messages import LATCHED, flat, vector_message
from .runtime import SettingsNode, run
from .shutdown import Shutdown
from .topics import DEPTH, Fetcher, name_rivals, quality

Array = NDArray[np.float64]

#: How often what has come is fetched and used [s].
PERIOD = 0.1
#: Bands that are narrower than what was published by this factor are published, too.
NARROWER = 0.5


class Tracker(SettingsNode):
    """Learns in a thread of its own, so that services answer meanwhile; publishes what has moved."""

    PROGRAM = 'tracker'
    SUMMARY = (
        'Follows the parameters of a rig while it moves: publishes them, latched, on pendubot/params where they have '
        'moved by more than their 95 % bands, with how far to trust them and what changed on pendubot/identification. '
        '~/hold keeps what is published as it is, ~/reset begins anew.'
    )
    SETTINGS = (
        Setting('joint_names', list(JOINT_NAMES), 'names of shoulder and elbow in joint_states'),
        Setting('start', '', 'result file to begin with; empty: the first motion is identified'),
        Setting('model', 'coulomb', 'which parameters there are, without a start', choices=tuple(MODELS)),
        Setting('rate', 1.0, 'parameters are published at most so often', 'Hz', 0.01, 10.0, dynamic=True),
    )

    def __init__(self, ended: Shutdown) -> None:
        super().__init__(ended)
        s = self.settings()
        self._tracker = tracking.Tracker(start_of(Path(s['start'])) if s['start'] else start_of(None, s['model']))
        self._params = self.create_publisher(Float64MultiArray, 'pendubot/params', LATCHED)
        self._identification = self.create_publisher(DiagnosticArray, 'pendubot/identification', LATCHED)
        self._tell = StatusPublisher(self)
        self._decode = JointDecoder(s['joint_names'], self.resolve_topic_name('joint_states'))
        self._fetcher = Fetcher(self, lambda _, data, info: self._waiting.append(data))
        self._joint_states = self._fetcher.subscribe('joint_states', JointState, quality(DEPTH, True, False))
        self._rivals = ''  # names the publishers of joint states while there are several
        self._waiting: list[bytes] = []
        self._first_ns: int | None = None
        self._taken = 0
        #: What was published, and when by the samples' clock [s]; likewise what was said of it.
        self._published: State | None = None
        self._said: tuple[Any, ...] = ()
        self._at = -np.inf
        self._last_change = ''
        self._disturbances = 0
        self._held, self._forget = threading.Event(), threading.Event()
        self.create_service(SetBool, '~/hold', self._on_hold)
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_timer(1.0, self._diagnose)
        self._closing = threading.Event()
        self._worker = threading.Thread(target=self._work, daemon=True)
        self._worker.start()
        self.get_logger().info(self._tracker.waiting)

    def check(self, values: dict[str, Any]) -> None:
        """Refuse settings that make no sense together."""
        if len(set(values['joint_names'])) != 2 or '' in values['joint_names']:
            raise ParameterError(f'joint_names are {values["joint_names"]}; two different names are expected')

    def close(self) -> None:
        """Let the thread come to its end, but not wait for an identification that it is in."""
        self._closing.set()
        self._worker.join(1.0)

    def _on_hold(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data:
            self._held.set()
        else:
            self._held.clear()
        response.success = True
        response.message = 'what is published stays as it is' if request.data else 'what moves is published'
        return response

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._forget.set()
        return Trigger.Response(success=True, message='all begins anew with the next motion')

    def _work(self) -> None:
        while not self._closing.wait(PERIOD):
            try:
                if self._forget.is_set():
                    self._forget.clear()
                    self._tracker.reset()
                    self._published = None
                while self._fetcher.fetch() and not self._closing.is_set():
                    pass
                self._refuse_second_rig()
                self._learn()
                self._publish()
            except PendubotError as error:
                self.get_logger().error(str(error), throttle_duration_sec=10.0)
            except Exception as error:  # nobody else would hear of it
                self.get_logger().error(f'{type(error).__name__}: {error}', throttle_duration_sec=10.0)

    def _refuse_second_rig(self) -> None:
        """Drop the samples where they have several publishers, and begin anew: nobody knows whose they are."""
        before, self._rivals = self._rivals, name_rivals(self, self._joint_states, wait=True)
        if self._rivals and not before:
            self.get_logger().error(self._rivals)
        if self._rivals or before:
            self._waiting.clear()
            self._forget.set()

    def _learn(self) -> None:
        waiting, self._waiting = self._waiting, []
        if not waiting:
            return
        stamps, values = self._decode(Messages.of(waiting))
        if self._first_ns is None:
            self._first_ns = int(stamps[0])
        self._taken += len(stamps)
        t = (stamps - self._first_ns) / 1e9
        for event in self._tracker.feed(np.column_stack([t, values[:, 0], values[:, 1]])):
            if not isinstance(event, State):
                self._happened(event)

    def _happened(self, event: Event) -> None:
        if isinstance(event, Disturbance):
            self._disturbances += 1
            self.get_logger().info(str(event))
            return
        self._last_change = str(event)
        self._published = None if isinstance(event, Lost) else self._published
        # Parameters that are known to be wrong do not wait for their turn.
        self._at = -np.inf
        self.get_logger().warning(str(event))

    def _publish(self) -> None:
        state = self._tracker.state
        if self._held.is_set():
            return
        if self._rivals:
            self._say(Level.ERROR, self._rivals, {})
            return
        if state is None:
            self._say(Level.WARN, self._tracker.waiting, {})
            return
        due = state.t - self._at >= 1 / self.get_parameter('rate').value or state.t < self._at
        if due and state.level is not Level.ERROR and self._moved(state):
            if self._published is None:
                self.get_logger().info(f'following, level {state.level.name}: {self._headline(state)}')
            self._published, self._at = state, state.t
            self._say(state.level, self._headline(state), self._values(state))
            self._params.publish(vector_message(state.theta))
        elif due:
            # What is said is of the parameters that were published, so that whoever took them is told.
            shown = self._published or state
            self._say(state.level, self._headline(state), self._values(shown))

    def _moved(self, state: State) -> bool:
        last = self._published
        if last is None:
            return True
        moved = np.abs(state.theta - last.theta) > NORMAL_95 * state.std_error
        return bool(moved.any() or (state.std_error < NARROWER * last.std_error).any())

    def _headline(self, state: State) -> str:
        return '; '.join(state.warnings) or 'followed'

    def _values(self, state: State) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for name, entry in parameters(state).items():
            said = asdict(entry)
            values |= {name: said.pop('value'), **flat(name, said)}
        segment_settings = self._tracker.segment_settings
        if segment_settings is not None:
            values |= flat('effort', asdict(effort_taken(state, segment_settings)))
            values['model'] = segment_settings.model
        return values | {'criterion': 'weak, tracked', 'last_change': self._last_change or 'none'}

    def _say(self, level: Level, headline: str, values: dict[str, Any]) -> None:
        """Publish a judgement, unless it is what was said last; numbers of seconds make no other."""
        key = level, ''.join(c for c in headline if not c.isdigit()), values
        if key != self._said:
            self._said = key
            message = diagnostics_message(stamp_now(self), 'pendubot identification', level, headline, values)
            self._identification.publish(message)

    def _diagnose(self) -> None:
        state, notes = self._tracker.state, self._tracker.notes
        values = {
            'samples': self._taken,
            'disturbances': self._disturbances,
            'last change': self._last_change or 'none',
            **notes,
        }
        if state is not None:
            values |= {'moving': state.moving, 'unexplained torque [N m]': state.unexplained}
        level = Level.WARN if state is None else state.level
        summary = self._tracker.waiting if state is None else self._headline(state)
        if self._rivals:
            level, summary = Level.ERROR, self._rivals
        self._tell(level, ('held; ' if self._held.is_set() else '') + summary, values)


main = partial(run, Tracker)

if __name__ == '__main__':
    raise SystemExit(main())
