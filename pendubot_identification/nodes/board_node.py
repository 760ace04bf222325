# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The node ``virtual_board``: what can be changed of a virtual rig while it moves."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from pendubot_identification.link.virtual_board import VirtualBoard
from pendubot_identification.setting import Setting

from .runtime import SettingsNode
from .shutdown import Shutdown


class BoardNode(SettingsNode):
    """Puts a payload on link 2 of the rig behind a virtual board."""

    PROGRAM = 'virtual_board'
    SUMMARY = 'A virtual board with a pendubot behind it.'
    SETTINGS = (
        Setting('payload', 0.0, 'what link 2 carries, at its centre of percussion', 'kg', 0.0, 10.0, dynamic=True),
    )

    def __init__(self, board: VirtualBoard, ended: Shutdown) -> None:
        super().__init__(ended)
        board.carry(self.get_parameter('payload').value)

        def changed(parameters: Sequence[Parameter]) -> None:
            for parameter in parameters:
                if parameter.name == 'payload':
                    board.carry(parameter.value)
                    self.get_logger().info(f'link 2 carries {parameter.value:g} kg')

        self.add_post_set_parameters_callback(changed)


@contextmanager
def changeable(board: VirtualBoard, argv: Sequence[str], ended: Shutdown) -> Iterator[None]:
    """Have a board's node answer in a thread of its own."""
    rclpy.init(args=list(argv), signal_handler_options=SignalHandlerOptions.NO)
    try:
        executor = SingleThreadedExecutor()
        executor.add_node(BoardNode(board, ended))

        def spin() -> None:
            with suppress(ExternalShutdownException):
                executor.spin()

        thread = threading.Thread(target=spin, daemon=True)
        thread.start()
        try:
            yield
        finally:
            executor.shutdown(timeout_sec=2.0)
            thread.join(2.0)
    finally:
        rclpy.try_shutdown()
