# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Trajectories and settings in; parameters with covariance, level and warnings out: one pipeline.

It reads from the top in :mod:`.pipeline`: prepare, check conventions, fit, check residuals, validate, assess.
"""
