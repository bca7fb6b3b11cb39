"""Settings file of the agent: its sections, the functions that load it, and the secrets that it names."""
