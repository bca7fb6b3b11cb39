"""Machine and ball bar that warm up while they are measured against each other."""
