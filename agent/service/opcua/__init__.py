"""OPC UA server; docs/reference/opc-ua.md says what it offers and what it does not claim."""
