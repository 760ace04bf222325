# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The balancer without ROS: computes the torque that swings the rig up and balances it, from parameters and samples.

``balancing`` collects the inputs and decides when to start and stop; ``plan`` computes and simulates a design.
``controller`` computes each torque by ``linear_control`` from the state of ``estimator``; ``sign_check`` detects wrong
wiring. Only nodes and the command line import this package.
"""
