# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Parameter files, against what rclpy itself takes from them."""

import pytest

from pendubot_identification.parameter_files import unheard

pytestmark = pytest.mark.ros
NAMES = [
    *('bridge', '/bridge', 'bridg', '/**/bridge', '"**/bridge"', '/*/bridge', '"*/bridge"', '/*/*/bridge', '/**', '/*'),
    *('/lab1/bridge', 'lab1/bridge', '/**/lab1/bridge', '/lab1/**', '/lab1/*', '/lab1/*/bridge', '/a/b/bridge'),
    *('/lab1: {bridge', '/a: {b: {bridge', '/a: {"*"', '/a: {"**": {bridge', '/a/*: {bridge', '/**: {bridge'),
]


def takes(rclpy, file, namespace):
    """Whether a node named bridge in this namespace takes the file's parameter."""
    arguments = ['--ros-args', '--params-file', str(file), '-r', f'__ns:={namespace}']
    context = rclpy.Context()
    rclpy.init(context=context, args=['bridge', *arguments])
    node = rclpy.create_node('bridge', context=context)
    try:
        return 'port' in node._parameter_overrides
    finally:
        node.destroy_node()
        context.try_shutdown()


def test_says_of_a_file_that_nothing_is_taken_when_that_is_so(ros, tmp_path):
    file = tmp_path / 'mine.yaml'
    for name in NAMES:
        file.write_text(f'{name}: {{ros__parameters: {{port: /nowhere}}}}' + '}' * name.count('{'))
        for namespace in ('/', '/lab1', '/a/b'):
            node = f'{namespace.rstrip("/")}/bridge'
            sentences = unheard(['bridge', '--ros-args', '--params-file', str(file)], node)
            assert (sentences == []) == takes(ros, file, namespace), (name, namespace)
            assert all(f'nothing is taken from {file}: it holds parameters of /' in sentence for sentence in sentences)


def test_says_it_of_each_file_on_its_own(tmp_path):
    mine, others, none = (tmp_path / f'{name}.yaml' for name in ('mine', 'others', 'none'))
    mine.write_text('/**/bridge: {ros__parameters: {port: /nowhere}}')
    others.write_text('recorder: {ros__parameters: {output: swing}}\nexciter: {ros__parameters: {seed: 2}}')
    none.write_text('{}')
    arguments = [word for file in (mine, others, none) for word in ('--params-file', str(file))]
    advice = 'and none of /lab1/bridge; name /lab1/bridge in it, or /**/bridge for every namespace'
    assert unheard(arguments, '/lab1/bridge') == [
        f'nothing is taken from {others}: it holds parameters of /recorder, /exciter, {advice}',
        f'nothing is taken from {none}: it holds no parameters of any node, {advice}',
    ]
