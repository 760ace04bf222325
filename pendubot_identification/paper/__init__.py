# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""All that only the reproduction of the paper needs: its functions, competitors, trials, tables, figures, command."""
