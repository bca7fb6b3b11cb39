"""Predicted figures of acceptance tests, compared with virtual instruments on machines that share no code with the
program."""
