"""Set-up of a machine that volcal does not know yet: what can be stated about it, what is proposed, and its files.

Every value that a person can state is one entry of the table in `fields`. Options of `volcal init`, questions in the
terminal, the form of the set-up page and comments of the files are made from it.
"""
