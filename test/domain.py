# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A private ROS domain, which isolates tests and benchmarks from other ROS programs."""

import contextlib
import os
import random
import socket

#: A demo takes one of the domains 1 to 100. The ports of both ranges are outside Linux's ephemeral range.
DOMAINS = [*random.sample(range(215, 232), 17), *random.sample(range(1, 101), 100)]
#: Sockets that reserve the domain during this process, on the port of ROS's domain_coordinator.
RESERVED = []


def take_domain():
    """Join a domain that no other process of tests or benchmarks on this machine uses."""
    for domain in DOMAINS:
        reserved = socket.socket()
        with contextlib.suppress(OSError):
            reserved.bind(('', 32768 + domain))
            os.environ['ROS_DOMAIN_ID'] = str(domain)
            RESERVED.append(reserved)
            return
    raise RuntimeError('more than a hundred processes test on this machine; wait until one has ended')
