"""The pendubot as equations: parameters and a state in; accelerations, energy, simulated motion, sensitivities out.

The compiled kernel beside it does the long loops; without a compiler numpy does the same work.
"""
