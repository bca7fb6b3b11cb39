"""Optimal design: choice of positions that minimise the error after compensation within the available machine time."""
