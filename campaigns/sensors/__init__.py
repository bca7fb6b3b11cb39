"""Machines in halls with weather, made without the code of the program, and what it says of their sensors."""
