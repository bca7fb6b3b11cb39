"""The mathematics of the digital twin: pure functions and frozen values, numpy and scipy only."""
