"""Servers and CAN nodes through which clients reach the world.

Written from the protocol documents; they have no physics.
"""
