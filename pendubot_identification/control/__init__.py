# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The balancer without ROS: parameters and samples in; out, the torque that swings the rig up and balances it.

``readiness`` collects the inputs, ``plan`` makes a design and tries it in simulation, ``balancing`` decides
when to begin and stop, and ``controller`` computes each torque by ``linear_control`` and ``swing_up``, from the state
that ``estimator`` follows; ``sign_check`` watches. Only nodes and the command line import it.
"""
