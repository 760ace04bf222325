# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Measurements of accuracy, speed and robustness for the tables of docs/benchmarks.md."""
