"""The pendubot: its parameters, its equations of motion, its simulation."""
