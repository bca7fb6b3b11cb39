"""Simulated controller that sends and receives its parameters in paper tape format over a serial line."""
