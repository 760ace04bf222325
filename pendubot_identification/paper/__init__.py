# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The reproduction of the paper: benchmark functions, algorithms, experiments, tables and figures."""
