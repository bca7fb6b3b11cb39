"""Web page for the operator and the engineer at the machine, served without external resources."""
