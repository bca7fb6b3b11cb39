"""A run interrupted at every instant of every step and resumed."""
