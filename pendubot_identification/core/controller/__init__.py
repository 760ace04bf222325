"""A controller that uses the parameters: swing up and balance."""
