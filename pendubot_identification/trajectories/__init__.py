"""Samples of a motion in; smoothed states, splines of time, and doubts about the samples out. No file is known here."""
