"""Device roles, the links that reach devices, and the drivers that ship with volcal."""
