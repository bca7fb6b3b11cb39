"""Physics of the simulated machine: no sockets, no threads, no clock of its own."""
