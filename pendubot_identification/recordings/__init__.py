"""What was recorded, as files: bags and CSV files in and out as trajectories; bags written, read and repaired."""
