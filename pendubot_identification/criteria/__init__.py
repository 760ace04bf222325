"""A trajectory and a model in; what is minimised (energy, weak, trajectory) and its minimum out."""
