# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Renders results as pages, figures and tables; makes no decisions."""
