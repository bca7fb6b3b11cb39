"""One run, interrupted at several instants of every step and resumed."""
