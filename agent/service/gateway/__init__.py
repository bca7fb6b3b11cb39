"""Modbus TCP server for panels and PLCs. Its interface is specified in docs/reference/panel-gateway.md."""
