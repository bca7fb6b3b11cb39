"""Seasons of machines that wear, made without the code of the program, and forecasts judged on them."""
