# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Measures the estimator's errors, repeatability and interval coverage: ``python -m benchmarks.estimator --help``."""
