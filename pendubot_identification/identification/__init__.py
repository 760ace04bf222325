# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Identification: parameters with covariance, level and warnings, from trajectories and settings.

The stages of :mod:`.pipeline` are: prepare, check conventions, fit, validate, assess.
"""
