"""Rotary mount with two drives on a CAN bus; the drives follow the CANopen drive profile CiA 402."""
