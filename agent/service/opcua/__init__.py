"""OPC UA server. Its scope and limits are stated in docs/reference/opc-ua.md."""
