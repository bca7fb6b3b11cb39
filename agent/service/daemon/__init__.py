"""Service process: its endpoints, signals, systemd notification and logging."""
