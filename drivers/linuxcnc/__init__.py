"""LinuxCNC as a controller."""
