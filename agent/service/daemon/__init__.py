"""Life of the service process: endpoints, signals, systemd notification and logging."""
