# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""A result in; the text of a file for simulators, controllers, firmware and other programs out."""
