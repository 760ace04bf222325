# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""From a bag to parameters: python bag_to_parameters.py [BAG [RESULT.yaml]]."""

import sys
from pathlib import Path

from pendubot_identification import identify

bag = sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1] / 'bags' / 'paper_experiment'

# The first half is for training, the second for validation. In a notebook, `found` at the end of a cell is a table.
found = identify(bag)
print(found)

# As arrays, in the order of found.names.
for name, value, (low, high) in zip(found.names, found.theta, found.intervals, strict=True):
    print(f'{name} = {value:.5g}, 95 % between {low:.5g} and {high:.5g}')

if len(sys.argv) > 2:
    found.save(sys.argv[2])
