# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Minimisation of a function or a quadratic form within bounds."""
