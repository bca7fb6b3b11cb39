"""A plant for a real LinuxCNC: the simulated world's machine, balls and mount around a controller that is none of it."""
