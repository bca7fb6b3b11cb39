"""Servers and CAN nodes through which clients reach the simulated world.

They are written from the protocol documents and contain no physics.
"""
