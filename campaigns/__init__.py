"""Long trials of the whole agent on simulated machines. Each trial prints its result as one line of JSON at the end.

Terms are defined in docs/reference/glossary.md.
"""
