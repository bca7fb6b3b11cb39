"""Bridge process between volcal and LinuxCNC.

The Python interpreter of the operating system runs this directory; volcal itself never imports it.
"""
