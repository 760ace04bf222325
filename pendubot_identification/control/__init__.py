# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The balancer without ROS: parameters and samples in; out, the torque that swings the rig up and balances it.

``readiness`` collects what must be known, ``plan`` makes a design (``linear_control``, ``swing_up``) and tries it in
``closed_loop``, ``balancing`` decides when to begin and stop, and ``controller`` computes each torque with the help of
``estimator`` and ``sign_check``. Only nodes and the command line import it.
"""
