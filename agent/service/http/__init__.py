"""HTTP endpoint: status, journal and events for everyone, commands for holders of the token."""
