"""Servers and CAN nodes through which clients reach the world.

They are written from the protocol documents and contain no physics.
"""
