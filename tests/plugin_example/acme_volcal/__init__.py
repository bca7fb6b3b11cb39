"""volcal driver for ACME controllers, which exchange lines of text over TCP."""
