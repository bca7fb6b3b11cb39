"""Contract tests of the device roles, to be subclassed by the tests of each driver.

Needs pytest. See docs/how-to/write-a-driver-plugin.md.
"""
