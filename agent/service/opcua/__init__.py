"""OPC UA server. docs/reference/opc-ua.md states its scope and limits."""
