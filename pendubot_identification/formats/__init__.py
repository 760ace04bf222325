# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Exports results to simulators, controllers, firmware and other programs, as the text of a file."""
