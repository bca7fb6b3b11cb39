"""Operator device that asks through the terminal in which volcal runs."""
