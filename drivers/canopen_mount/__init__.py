"""Rotary mount of two CiA 402 drives on a CAN bus."""
