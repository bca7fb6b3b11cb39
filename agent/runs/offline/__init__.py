"""Estimates from files, without a machine: an identification, and the machine between two nights."""
