"""Virtual measuring instruments, which observe the true behaviour of a simulated machine with errors of their own."""
