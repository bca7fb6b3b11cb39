"""Simulated CANopen drives of the rotary mount, and the CAN buses that connect them."""
