"""Commands that start the service or send requests to it; the latter import neither numerical libraries nor drivers."""
