"""What every player of a role must do, whoever wrote it: test classes to be subclassed by a driver's own tests.

Needs pytest. See docs/how-to/write-a-driver-plugin.md.
"""
