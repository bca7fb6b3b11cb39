"""Run interrupted at every instant of every step, and resumed."""
