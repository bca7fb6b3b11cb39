"""Commands that compute from files and need neither a machine nor the service."""
