"""Optimal design: choice of the positions that minimise the error after compensation within the available machine time."""
