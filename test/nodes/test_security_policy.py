# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The SROS2 policy, compared with the topics and services of the real nodes."""

from contextlib import ExitStack
from fnmatch import fnmatchcase
from itertools import product
from xml.etree import ElementTree

import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64

from pendubot_identification.model.parameters import PAPER
from test.conftest import ROOT, SAMPLE
from test.identified import written
from test.processes import Program, parameters, spin_until

EFFORT = '/pendubot/effort_command'
LOOK = {
    'publish': 'get_publisher_names_and_types_by_node',
    'subscribe': 'get_subscriber_names_and_types_by_node',
    'reply': 'get_service_names_and_types_by_node',
    'request': 'get_client_names_and_types_by_node',
}
#: Topics and services of an action, by role of the node.
ACTIONS = {
    'execute': {
        'publish': ('/_action/feedback', '/_action/status'),
        'reply': ('/_action/send_goal', '/_action/get_result', '/_action/cancel_goal'),
    },
    'call': {},
}


def policy():
    """Return the patterns of names that each enclave allows, by node and kind, such as ('bridge', 'publish')."""
    allowed = {}
    (enclaves,) = ElementTree.parse(ROOT / 'config' / 'sros2_policy.xml').getroot()
    for enclave in enclaves:
        (profile,) = enclave.findall('profiles/profile')
        node = profile.get('ns') + profile.get('node')
        assert enclave.get('path') == f'/pendubot{node}'
        for rules in profile:
            ((kind, qualifier),) = rules.attrib.items()
            assert qualifier == 'ALLOW'
            names = {'/' + entry.text.replace('~', node).removeprefix('/') for entry in rules}
            for each, parts in ACTIONS.get(kind, {kind: ('',)}).items():
                full = {name + part for name in names for part in parts}
                allowed.setdefault((profile.get('node'), each), set()).update(full)
    return allowed


def mismatches(names, expressions):
    """Return names that no pattern allows, and patterns that no name needs."""
    wrong = {name for name in names if not any(fnmatchcase(name, each) for each in expressions)}
    return wrong | {each for each in expressions if not any(fnmatchcase(name, each) for name in names)}


def test_the_policy_allows_exactly_the_topics_and_services_that_the_nodes_use(ros, node, tmp_path):
    # The balancer publishes torques only while it drives (test_balancer).
    used = {('balancer', 'publish'): {EFFORT}}
    allowed = policy()
    values = {
        'bridge': {'port': tmp_path / 'board'},
        'recorder': {'output': tmp_path / 'bag', 'topics': f'[joint_states, {EFFORT}, /pendubot/joint_commands]'},
        'player': {'bag': SAMPLE, 'topics': '[joint_states]', 'rate': 0.01},
    }
    values['player']['ghost'] = written(tmp_path / 'rig.yaml', PAPER)

    def differences(observer, programs):
        """Return names used but not allowed, and patterns allowed but not used, by program and kind."""
        nodes = {name for name, _ in observer.get_node_names_and_namespaces()}
        for program, kind in product(nodes.intersection(programs), LOOK):
            topics = getattr(observer, LOOK[kind])(program, '/')
            used.setdefault((program, kind), set()).update(name for name, _ in topics)
        compared = {each: mismatches(used.get(each, ()), allowed.get(each, ())) for each in product(programs, LOOK)}
        return {each: wrong for each, wrong in compared.items() if wrong}

    def start(*names):
        words = {name: ['--link', tmp_path / 'board'] if name == 'virtual_board' else [] for name in names}
        started = [
            programs.enter_context(Program(name, *words[name], *parameters(**values.get(name, {})))) for name in names
        ]
        # On a busy machine a Fast DDS participant may miss a node: a new participant looks again.
        for _ in range(4):
            with ros.Context() as context:
                observer = ros.create_node('observer', context=context)
                if spin_until(node, lambda observer=observer: not differences(observer, names), 15.0):
                    return started
                missed = str(differences(observer, names))
        return pytest.fail(
            '\n'.join([missed, *(f'{each.name} {each.process.poll()}: {each.output}' for each in started)])
        )

    with ExitStack() as programs:
        # The exciter would end beside the player, a second publisher of joint states.
        bridge, _ = start('bridge', 'exciter')
        bridge.stop()
        # The recorder subscribes only to topics with a publisher.
        node.create_publisher(JointState, '/pendubot/joint_commands', 1)
        node.create_publisher(Float64, EFFORT, 1)
        start('player', 'identifier', 'recorder', 'balancer', 'tracker', 'virtual_board')
    drivers = {node for (node, kind), names in allowed.items() if kind == 'publish' and EFFORT in names}
    assert drivers == {'exciter', 'balancer'}
    # The operator may call the services of every node.
    served = {name for (_, kind), names in used.items() if kind == 'reply' for name in names}
    assert not mismatches(served, allowed[('operator', 'request')])
