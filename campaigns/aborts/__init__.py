"""One whole run interrupted at each of its steps in every way; checks that the machine is always
left as it was found.
"""
