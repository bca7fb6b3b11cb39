"""Trial of one run with write-back whose process is killed at each commit of its journal and around each command to the
machine. After each kill volcal is started again.
"""
