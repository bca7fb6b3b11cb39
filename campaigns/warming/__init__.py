"""A machine and a ball bar that warm up while they measure each other."""
