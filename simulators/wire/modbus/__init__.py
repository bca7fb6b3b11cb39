"""Simulated controller behind the Modbus register map (TCP and RTU)."""
