"""Commands for compensation tables: show, export and restore them, and correct part programs with them."""
