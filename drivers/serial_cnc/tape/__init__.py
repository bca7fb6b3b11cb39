"""Parameters and tables in tape format over RS-232: punched by the controller, read by it, compared after a write."""
