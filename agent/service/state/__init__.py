"""Published state of the service: status board, event log, archive and reports."""
