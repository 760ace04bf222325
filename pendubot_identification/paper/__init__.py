# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""The reproduction of the paper: functions, algorithms, experiments, tables, figures."""
