"""Runs on a machine: start, carry out, resume, abandon; and identification from files."""
