"""Physics of the simulated machine, without sockets, threads or a clock of its own."""
