"""Simulated controller that sends and receives its parameters as paper tapes."""
