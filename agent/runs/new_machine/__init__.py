"""Steps from what is stated about a machine to its files, shared by `volcal init` and by the set-up page."""
