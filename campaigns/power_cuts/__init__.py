"""Trial of power cuts at each system call of a process that writes a journal and a file: what was acknowledged must be
there afterwards.
"""
