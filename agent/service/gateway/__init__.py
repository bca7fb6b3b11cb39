"""Modbus TCP server for panels and PLCs. docs/reference/panel-gateway.md is its contract."""
