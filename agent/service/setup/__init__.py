"""State of the set-up of a new machine on the web page. No room of the running service uses it."""
