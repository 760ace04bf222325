"""Parameters and samples in; the torque that swings the rig up and balances it out. Nothing but its node imports it."""
