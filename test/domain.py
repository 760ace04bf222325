# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A ROS domain of one's own, so that tests and benchmarks neither hear nor disturb other ROS programs."""

import contextlib
import os
import random
import socket

#: A demo takes one of the domains 1 to 100. The ports of both ranges are outside those that Linux gives to any program.
DOMAINS = [*random.sample(range(215, 232), 17), *random.sample(range(1, 101), 100)]
#: What keeps the domain while this process lives: the port that ROS's own domain_coordinator takes for it, too.
KEEPERS = []


def take_domain():
    """Join a domain that no other process of tests or benchmarks on this machine has."""
    for domain in DOMAINS:
        keeper = socket.socket()
        with contextlib.suppress(OSError):
            keeper.bind(('', 32768 + domain))
            os.environ['ROS_DOMAIN_ID'] = str(domain)
            KEEPERS.append(keeper)
            return
    raise RuntimeError('more than a hundred processes test on this machine; wait until one has ended')
