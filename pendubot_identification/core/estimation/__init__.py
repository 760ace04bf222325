"""From motions to parameters, how uncertain they are, and what they are worth."""
