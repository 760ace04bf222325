# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""How accurate, repeatable and truthful the estimator is: ``python -m benchmarks.estimator --help``."""
