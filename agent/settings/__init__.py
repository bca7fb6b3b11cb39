"""The settings file: its sections, how it is loaded, and the secrets that it names."""
