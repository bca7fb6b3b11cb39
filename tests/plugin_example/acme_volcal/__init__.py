"""A volcal driver for ACME controllers, which speak one line of text at a time over TCP."""
