"""Simulated controller that clients reach through the Modbus register map (TCP and RTU)."""
