"""Operator device that asks its questions in the terminal in which volcal runs."""
