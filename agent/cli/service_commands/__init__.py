"""Commands that start the service, and commands that send requests to it. The latter import neither numerical libraries
nor drivers.
"""
