"""Optimal design: choice of positions for the smallest expected error after compensation within the available machine
time."""
