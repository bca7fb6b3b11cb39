"""HTTP endpoint. Everyone can read status, journal and events; commands are for holders of the access token."""
