"""Bridge process between volcal and LinuxCNC. The system's Python runs this directory; volcal never imports it."""
