"""Access to the requests of the service: roles, pairing codes, and the clients that were paired with one."""
