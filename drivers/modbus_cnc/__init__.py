"""CNC or PLC behind Modbus TCP registers; the contract is docs/reference/modbus-register-map.md."""
