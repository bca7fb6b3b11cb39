"""Command `volcal init`: questions about a machine, and the files that follow from the answers."""
