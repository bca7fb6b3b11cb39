"""Driver for a CNC or a PLC with Modbus registers, over TCP or a serial line.

The registers are defined in docs/reference/modbus-register-map.md.
"""
