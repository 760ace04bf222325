# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A function or a quadratic form and bounds in; the vector that minimises it out."""
