"""The next recording: torques that tell much."""
