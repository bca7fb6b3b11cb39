"""Simulated controller that punches and reads its parameters as tapes."""
