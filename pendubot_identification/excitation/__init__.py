"""A rig's limits in; the torques that make it move, the paper's pulses or designed ones, out."""
