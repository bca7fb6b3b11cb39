"""Trial in which one run is interrupted at several instants of every step and then resumed."""
