# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The policy for SROS2 against the real nodes: it allows what each of them uses, and nothing that none of them does."""

from contextlib import ExitStack
from fnmatch import fnmatchcase
from itertools import product
from xml.etree import ElementTree

import pytest

from test.conftest import ROOT
from test.processes import Program, parameters, spin_until

pytestmark = pytest.mark.ros
EFFORT = '/pendubot/effort_command'


def policy():
    """What each enclave allows: expressions by kind, such as (enclave, 'publish'), as full names."""
    allowed = {}
    (enclaves,) = ElementTree.parse(ROOT / 'config' / 'sros2_policy.xml').getroot()
    for enclave in enclaves:
        (profile,) = enclave.findall('profiles/profile')
        node = profile.get('ns') + profile.get('node')
        assert enclave.get('path') == f'/pendubot{node}'
        for rules in profile:
            ((kind, qualifier),) = rules.attrib.items()
            assert qualifier == 'ALLOW'
            names = allowed.setdefault((profile.get('node'), kind), set())
            for entry in rules:
                name = entry.text.replace('~', node)
                names.add(name if name.startswith('/') else f'/{name}')
    return allowed


def test_the_policy_allows_what_the_nodes_use_and_no_more(ros, tmp_path):
    observer, used, allowed = ros.create_node('observer'), {}, policy()
    look = {
        'publish': observer.get_publisher_names_and_types_by_node,
        'subscribe': observer.get_subscriber_names_and_types_by_node,
        'reply': observer.get_service_names_and_types_by_node,
        'request': observer.get_client_names_and_types_by_node,
    }
    values = {
        'bridge': {'port': tmp_path / 'board'},
        'recorder': {'output': tmp_path / 'bag'},
        'player': {'bag': ROOT / 'bags/paper_experiment', 'topics': '[joint_states]', 'rate': 0.01, 'clock': 1.0},
    }

    def differences(programs):
        """What one of them uses and may not, and what it may and has not been seen to use."""
        there = {name for name, _ in observer.get_node_names_and_namespaces()}
        found = []
        for program, kind in product(programs, look):
            names, expressions = used.setdefault((program, kind), set()), allowed.get((program, kind), set())
            if program in there:
                names |= {name for name, _ in look[kind](program, '/')}
            found += [(program, kind, n) for n in names if not any(fnmatchcase(n, e) for e in expressions)]
            found += [(program, kind, e) for e in expressions if not any(fnmatchcase(n, e) for n in names)]
        return found

    def start(*names):
        started = [programs.enter_context(Program(name, *parameters(**values.get(name, {})))) for name in names]
        assert spin_until(observer, lambda: not differences(names), 30.0), differences(names)
        return started

    try:
        with ExitStack() as programs:
            *_, exciter = start('bridge', 'player', 'identifier', 'recorder', 'exciter')
            exciter.stop()  # it gives way to a balancer
            start('balancer')
    finally:
        observer.destroy_node()
    # Who commands torques is what it is all about.
    drivers = {node for (node, kind), names in allowed.items() if kind == 'publish' and EFFORT in names}
    assert drivers == {'exciter', 'balancer'}
    # Whoever calls services by hand may call those of every node.
    served = {name for (_, kind), names in used.items() if kind == 'reply' for name in names}
    called = allowed[('operator', 'request')]
    assert all(any(fnmatchcase(name, expression) for expression in called) for name in served)
    assert all(any(fnmatchcase(name, expression) for name in served) for expression in called)
