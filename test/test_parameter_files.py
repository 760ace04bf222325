# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The check of parameter files, compared with rclpy's own reading of them."""

import pytest

from pendubot_identification.errors import ParameterError
from pendubot_identification.parameter_files import refuse_untaken

pytestmark = pytest.mark.ros
NAMES = [
    *('bridge', 'bridg', '/**/bridge', '"*/bridge"', '/*/*/bridge', '/**', '/*', 'lab1/bridge', '/**/lab1/bridge'),
    *('/lab1/*', '/lab1/*/bridge', '/lab1: {bridge', '/a: {b: {bridge', '/a: {"**": {bridge', '/a/*: {bridge'),
]


def takes(rclpy, file, namespace):
    """Return whether a node named bridge in this namespace reads the file's parameter."""
    arguments = ['--ros-args', '--params-file', str(file), '-r', f'__ns:={namespace}']
    context = rclpy.Context()
    rclpy.init(context=context, args=['bridge', *arguments])
    node = rclpy.create_node('bridge', context=context)
    try:
        return 'port' in node._parameter_overrides
    finally:
        node.destroy_node()
        context.try_shutdown()


def test_exactly_the_files_from_which_rclpy_reads_no_parameter_are_refused(ros, tmp_path):
    file = tmp_path / 'mine.yaml'
    for name in NAMES:
        file.write_text(f'{name}: {{ros__parameters: {{port: /nowhere}}}}' + '}' * name.count('{'))
        for namespace in ('/', '/lab1', '/a/b'):
            node = f'{namespace.rstrip("/")}/bridge'
            if takes(ros, file, namespace):
                refuse_untaken(str(file), node)
            else:
                with pytest.raises(ParameterError, match=f'{file} has no effect: it contains parameters of /'):
                    refuse_untaken(str(file), node)
    for content in ('bridge: {ros__parameters: {}}', '{'):
        file.write_text(content)
        with pytest.raises(ParameterError, match='it contains no parameters of any node, and none of'):
            refuse_untaken(str(file), '/bridge')
