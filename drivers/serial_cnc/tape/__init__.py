"""Parameters and tables in tape format over RS-232: received, sent, and compared after a write."""
