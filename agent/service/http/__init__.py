"""The door over HTTP: status, journal and events for everybody, requests for who has the token."""
