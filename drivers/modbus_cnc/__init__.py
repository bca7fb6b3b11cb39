"""CNC or PLC with Modbus registers, over TCP or a serial line, as defined in docs/reference/modbus-register-map.md."""
