"""A plant for a real LinuxCNC: the machine, balls and mount of the simulated world around a controller that is real."""
