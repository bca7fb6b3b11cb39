"""Commands that start the service, and commands that send requests to the service.

The commands that send requests import neither numerical libraries nor device drivers.
"""
