"""A function or a quadratic form and bounds in; the vector that minimises it out."""
