"""Thin wrappers around the libraries for CAN, Modbus and serial ports; no other package imports these libraries."""
