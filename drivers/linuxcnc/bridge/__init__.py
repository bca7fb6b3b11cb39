"""Bridge process beside LinuxCNC: run as a directory by the system's Python, never imported by volcal."""
