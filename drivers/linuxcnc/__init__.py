"""Driver for machines controlled by LinuxCNC."""
